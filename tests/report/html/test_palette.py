"""Images in few colours: no different to look at, and smaller."""

import base64
import io

import numpy as np
from PIL import Image

from airswing.report.html.embed import embedded
from airswing.report.html.palette import png_in_palette, svg_in_palette
from airswing.report.html.style import new_figure, png_bytes


def drawing():
    figure = new_figure(4.0)
    axes = figure.subplots()
    at = np.random.default_rng(5).normal(size=(2, 20_000))
    axes.scatter(*at, s=4, c=at[0], alpha=0.4, rasterized=True)
    return figure


def pixels(content: bytes) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(content)).convert("RGBA")).astype(int)


def test_a_drawing_keeps_its_colours_and_its_white():
    content = png_bytes(drawing())
    few = png_in_palette(content)
    apart = np.abs(pixels(few) - pixels(content))
    assert len(few) < 0.5 * len(content)
    assert apart.mean() < 0.002 * 255 and np.percentile(apart, 99) <= 8
    assert pixels(few)[0, 0].tolist() == [255, 255, 255, 255]


def test_what_is_transparent_stays_so():
    image = np.zeros((60, 400, 4), np.uint8)
    image[:, 200:] = np.random.default_rng(1).integers(0, 255, (60, 200, 4))
    image[:, 200:, 3] = 255
    stream = io.BytesIO()
    Image.fromarray(image).save(stream, "png")
    few = pixels(png_in_palette(stream.getvalue()))
    assert (few[:, :200, 3] == 0).all() and (few[:, 200:, 3] == 255).all()
    inside = b'<svg><image href="data:image/png;base64,%s"/></svg>'
    whole = inside % base64.b64encode(stream.getvalue())
    made = svg_in_palette(whole)
    assert len(made) < 0.6 * len(whole) and made.endswith(b'"/></svg>')


def test_a_page_holds_the_small_image():
    figure = drawing()
    page = str(embedded(figure, raster=True, dpi=110))
    assert len(page) < 0.7 * len(base64.b64encode(png_bytes(figure, dpi=110)))
