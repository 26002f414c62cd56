"""Figures inside a page: PNG images as data addresses, with captions, and the same as files."""

from __future__ import annotations

import base64
import re
from dataclasses import dataclass
from pathlib import Path

from markupsafe import Markup
from matplotlib.figure import Figure

from airswing.errors import InputError
from airswing.report.html.style import PAGE_DPI, Units, png_bytes

#: Colours of the palette: a drawing has few, and their mixtures along edges.
_COLOURS = 256
#: Width in CSS pixels below which a figure is scrolled instead of made smaller: text of 9 points
#: is then 7 pixels high.
_LEAST_WIDTH = 560


def embedded(figure: Figure, file: Path | None = None, *, dpi: float = PAGE_DPI) -> Markup:
    """Return an HTML figure: the image, a link to the same image in `file`, and the caption."""
    content = png_bytes(figure, dpi=dpi, colours=_COLOURS)
    address = f"data:image/png;base64,{base64.b64encode(content).decode('ascii')}"
    width = round(float(figure.get_figwidth()) * 96)
    caption = str(getattr(figure, "caption", ""))
    alternative = caption.split(". ")[0].rstrip(".")
    image = Markup('<img src="{}" alt="{}" style="width:{}px;min-width:{}px">').format(
        address, alternative, width, min(width, _LEAST_WIDTH)
    )
    if file is not None:
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(content)
        except OSError as err:
            raise InputError("cannot write a figure", file=file, found=err.strerror) from err
        image = Markup('<a href="{}">{}</a>').format(f"{file.parent.name}/{file.name}", image)
    words = Markup("<figcaption>{}</figcaption>").format(caption) if caption else ""
    return Markup('<figure><div class="scroll">{}</div>{}</figure>').format(image, words)


@dataclass(frozen=True)
class Figures:
    """Places the figures of a page and writes each as a PNG file into a folder, if there is one."""

    folder: Path | None = None
    units: Units = "kt"

    def __call__(self, name: str, figure: Figure, *, dpi: float = PAGE_DPI) -> Markup:
        """Return the embedded figure; `name` becomes the file's name, made of plain letters."""
        plain = re.sub(r"[^A-Za-z0-9.-]+", "_", name).strip("_.")
        return embedded(figure, self.folder / f"{plain}.png" if self.folder else None, dpi=dpi)

    def clear(self) -> None:
        """Remove the files of an earlier page."""
        for file in self.folder.glob("*.png") if self.folder else ():
            file.unlink()
