"""Write pictures into one file: a GIF, or an HTML page that plays them."""

from __future__ import annotations

import base64
import html
import io
import json
import re
from collections.abc import Iterable, Sequence
from typing import IO, Any

import numpy as np

from .style import COLOURS

_COLOURS = 96  # number of colours of all pictures of a file together
_FIXED = ("#FFFFFF", *COLOURS)
_WEIGHT = 0.5  # the weight of a colour in the palette is its number of pixels to this power
_SAMPLES = 8  # pictures from which the palette is made


class Palette:
    """One set of colours for all pictures of a film.

    With common colours, pixels that do not change have equal indices, so each picture needs to
    store only what changes.

    Arguments:
        still: pixels (height, width, 3) of what does not move.
        some: a few of the pictures, pixels likewise.
    """

    def __init__(self, still: np.ndarray, some: Sequence[np.ndarray]) -> None:
        from PIL import Image

        red, green, blue = np.vstack([still, *some]).reshape(-1, 3).astype(np.int64).T
        packed, counts = np.unique(red << 16 | green << 8 | blue, return_counts=True)
        # Weighted by the number of pixels, large faces would take all colours of the palette; the
        # square root leaves some to thin lines and arrows.
        times = np.ceil(counts**_WEIGHT).astype(int)
        kinds = np.stack([packed >> 16, packed >> 8 & 255, packed & 255], 1).astype(np.uint8)
        found = Image.fromarray(np.repeat(kinds, times, axis=0)[None, :, :]).quantize(
            _COLOURS - len(_FIXED), Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE
        )
        fixed = [int(name[i : i + 2], 16) for name in _FIXED for i in (1, 3, 5)]
        colours = [*fixed, *(found.getpalette() or [])[: 3 * (_COLOURS - len(_FIXED))]]
        self.image = Image.new("P", (1, 1))
        self.image.putpalette(colours)
        self.colours = [*colours, *[255] * (3 * (_COLOURS + 1) - len(colours))]
        self.still = self.indices(still)

    def indices(self, pixels: np.ndarray) -> np.ndarray:
        """Return the index (height, width) of the colour of each pixel (height, width, 3)."""
        from PIL import Image

        picture = Image.fromarray(pixels)
        index = np.array(picture.quantize(palette=self.image, dither=Image.Dither.NONE))
        # Pillow does not always find the nearest colour; a white background must remain white.
        index[(pixels == 255).all(axis=2)] = 0
        return index

    def picture(self, indices: np.ndarray, over: np.ndarray | None = None) -> Any:
        """Return a picture of Pillow, transparent where it equals the one it is laid over."""
        from PIL import Image

        shown = indices if over is None else np.where(indices == over, _COLOURS, indices)
        image = Image.fromarray(shown.astype(np.uint8))
        image.putpalette(self.colours)
        return image

    def png(self, indices: np.ndarray, over: np.ndarray | None = None) -> str:
        """Return the same as a PNG in base 64."""
        buffer = io.BytesIO()
        picture = self.picture(indices, over)
        picture.save(buffer, "PNG", optimize=True, transparency=_COLOURS)
        return base64.b64encode(buffer.getvalue()).decode()


def sampled(count: int) -> list[int]:
    """Return the indices of the pictures from which a palette is made."""
    return sorted({int(i) for i in np.linspace(0, count - 1, min(count, _SAMPLES)).round()})


def write_gif(
    file: IO[bytes], pictures: Iterable[np.ndarray], palette: Palette, fps: float, count: int
) -> None:
    """Write pictures as a GIF that repeats.

    Arguments:
        file: open for writing.
        pictures: pixels (height, width, 3) of each.
        palette: made for them.
        fps: pictures per second.
        count: number of pictures.
    """
    indices = [palette.indices(picture) for picture in pictures]
    first, *rest = (
        palette.picture(own, before)
        for own, before in zip(indices, [None, *indices[:-1]], strict=True)
    )
    # A GIF counts in units of 10 ms. Rounding the times of the pictures instead of their durations
    # keeps the length of the film right.
    ticks = np.round(np.arange(count + 1) * 100 / fps).astype(int)
    first.save(
        file,
        "GIF",
        save_all=True,
        append_images=rest,
        loop=0,
        duration=[int(v) * 10 for v in np.diff(ticks)],
        transparency=_COLOURS,
        disposal=1,
        optimize=False,
    )


def write_page(
    file: IO[bytes],
    pictures: Iterable[np.ndarray],
    palette: Palette,
    fps: float,
    clocks: Sequence[str],
    title: str,
) -> None:
    """Write pictures as one HTML page with a player, which loads no other file.

    Arguments:
        file, pictures, palette, fps: as in `write_gif`.
        clocks: text below each picture.
        title: of the page.
    """
    height, width = palette.still.shape
    data = {
        "fps": fps,
        "clocks": list(clocks),
        "still": palette.png(palette.still),
        "frames": [palette.png(palette.indices(picture), palette.still) for picture in pictures],
    }
    # The data are inside a script: an escaped "<" keeps a text such as "</script>" from ending it.
    words = {
        "TITLE": html.escape(title),
        "LAST": str(len(clocks) - 1),
        "WIDTH": str(width),
        "HEIGHT": str(height),
        "DATA": json.dumps(data).replace("<", "\\u003c"),
    }
    page = re.sub("TITLE|LAST|WIDTH|HEIGHT|DATA", lambda match: words[match[0]], _PAGE)
    file.write(page.encode())


_PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8">
<meta name="viewport" content="width=device-width">
<title>TITLE</title>
<style>
body{font:14px sans-serif;margin:1em auto;max-width:1100px;padding:0 1em;color:#222;background:#fff}
canvas{max-width:100%;display:block}
div{display:flex;gap:.8em;align-items:center}
input{flex:1}
button,select{font:inherit;min-height:2.2em}
button{min-width:5em}
output{min-width:8em;font-family:monospace}
</style></head><body>
<canvas id="picture" width="WIDTH" height="HEIGHT" role="img" aria-label="TITLE"></canvas>
<div><button id="play">pause</button>
<input id="slider" type="range" min="0" max="LAST" value="0" aria-label="time">
<output id="clock"></output>
<select id="speed" aria-label="speed"><option value="0.1">0.1 x</option>
<option value="0.25">0.25 x</option><option value="0.5">0.5 x</option>
<option value="1" selected>1 x</option><option value="2">2 x</option></select></div>
<script>
"use strict";
const data = DATA;
const get = name => document.getElementById(name), last = data.frames.length - 1;
const [picture, play, slider, clock, speed] =
  ["picture", "play", "slider", "clock", "speed"].map(get);
let at = 0, before = null, running = !matchMedia("(prefers-reduced-motion: reduce)").matches;
function load(png) {
  const image = new Image();
  image.src = "data:image/png;base64," + png;
  return image;
}
const still = load(data.still), layers = data.frames.map(load), pen = picture.getContext("2d");
function show(i) {
  pen.drawImage(still, 0, 0);
  pen.drawImage(layers[i], 0, 0);
  slider.value = i;
  clock.textContent = data.clocks[i];
}
function step(now) {
  if (!running) { before = null; return; }
  if (before !== null) at += (now - before) / 1000 * data.fps * speed.value;
  before = now;
  if (at >= last + 1) at = 0;
  const i = Math.min(last, Math.floor(at));
  if (i !== +slider.value) show(i);
  requestAnimationFrame(step);
}
function run(on) {
  running = on;
  play.textContent = on ? "pause" : "play";
  before = null;
  if (on) requestAnimationFrame(step);
}
play.onclick = () => run(!running);
slider.oninput = () => { run(false); at = +slider.value; show(at); };
document.onkeydown = e => {
  if (e.key === " " && e.target === document.body) { e.preventDefault(); run(!running); }
};
Promise.all([still, ...layers].map(image => image.decode())).then(() => {
  show(0);
  run(running);
});
</script></body></html>
"""
