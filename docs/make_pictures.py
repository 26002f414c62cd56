"""Make the README's pictures from the sample's results: run after ``make run``."""

from __future__ import annotations

from pathlib import Path

from airswing.products.netcdf import open_product
from airswing.report.html import png_bytes
from airswing.report.run.heading_error import heading_error_figure

RESULTS = Path("results/quickstart")
IMAGES = Path("docs/images")


def main() -> None:
    """Write ``docs/images/heading_error.png``."""
    headings = open_product(RESULTS / "headings")
    fits = open_product(RESULTS / "fits.nc")
    figure = heading_error_figure(headings, fits, "N401", "ruc+rtfdaa")
    (IMAGES / "heading_error.png").write_bytes(png_bytes(figure, dpi=110, colours=256))


if __name__ == "__main__":
    main()
