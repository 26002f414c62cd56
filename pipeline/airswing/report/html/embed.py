"""Figures and pages on disk: images as data addresses, files written whole or not at all.

Assumes a target folder that exists or can be made.  A page is written to a temporary file
beside its place and renamed, so a reader sees the old page or the new one, never half of one.
"""

from __future__ import annotations

import base64
from pathlib import Path

from markupsafe import Markup, escape
from matplotlib.figure import Figure

from airswing.errors import InputError
from airswing.products.atomic import replacing
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
    content = png_bytes(figure, dpi=dpi) if raster else svg_bytes(figure, dpi=dpi)
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


def write_whole(path: Path, text: str) -> Path:
    """Write a text file by a temporary file and a rename.

    Parameters
    ----------
    path : Path
        Where the file shall stand; its folder is made where absent.
    text : str
        Its content, written as UTF-8.

    Returns
    -------
    Path
        The path given.

    Raises
    ------
    InputError
        If the folder cannot be made or written; what stood there before is untouched.
    """
    try:
        with replacing(path) as temporary:
            temporary.write_text(text, encoding="utf-8")
    except OSError as err:
        raise _unwritable(path, err) from err
    return path


def _unwritable(path: Path, err: OSError) -> InputError:
    return InputError(
        "cannot write the page",
        file=path,
        found=err.strerror or str(err),
        remedy="Choose another output folder or make room",
    )
