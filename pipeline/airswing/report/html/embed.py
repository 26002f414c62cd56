"""Figures inside a page: images as data addresses, with their captions."""

from __future__ import annotations

import base64

from markupsafe import Markup, escape
from matplotlib.figure import Figure

from airswing.report.html.palette import png_in_palette, svg_in_palette
from airswing.report.html.style import RASTER_DPI, png_bytes, svg_bytes


def embedded(figure: Figure, *, raster: bool = False, dpi: float = RASTER_DPI) -> Markup:
    """Return an HTML figure with its image inside the page and its caption below.

    The image stands in an ``img`` element, so that several SVGs cannot mix their identifiers.

    Parameters
    ----------
    figure : Figure
        Best a :class:`~airswing.report.html.style.CaptionedFigure`: its ``caption`` and
        ``alternative`` are used.
    raster : bool, optional
        PNG instead of SVG, for many small panels.
    dpi : float, optional
        Resolution of images.
    """
    # A label without words looks at every tick for a place beside them; the figure is not used
    # again, so none is given words later.
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            if not axis.label.get_text():
                axis.set_label_coords(0.5, 0.5)
    if raster:
        content = png_in_palette(png_bytes(figure, dpi=dpi))
    else:
        content = svg_in_palette(svg_bytes(figure, dpi=dpi))
    kind = "image/png" if raster else "image/svg+xml"
    address = f"data:{kind};base64,{base64.b64encode(content).decode('ascii')}"
    width = round(float(figure.get_figwidth()) * 96)
    caption = getattr(figure, "caption", "")
    alternative = getattr(figure, "alternative", "") or caption
    return Markup('<figure><img src="{}" alt="{}" style="width:{}px">{}</figure>').format(
        address,
        alternative,
        width,
        Markup("<figcaption>{}</figcaption>").format(escape(caption)) if caption else "",
    )
