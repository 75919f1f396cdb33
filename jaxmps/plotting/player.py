"""An animation with a slider, for notebooks and for files that stand by themselves."""

import base64
import html
import io
import json
import uuid
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from jaxmps.plotting.animation import indexed_pictures
from jaxmps.plotting.flow import Scene, heading
from jaxmps.results import Run
from jaxmps.validation import positive, whole

# Everything is in the page: what it shows does not depend on a network, a kernel or a widget.
_PAGE = """<div id="{name}" style="max-width:{width}px">
<img alt="{title}" style="width:100%"><div style="display:flex;gap:8px">
<button type="button" aria-label="play or pause">&#9654;</button>
<input type="range" min="0" max="{last}" value="0" step="1" aria-label="frame" style="flex:1"></div></div>
<script>(() => {{
const frames = {frames}, box = document.getElementById("{name}");
const image = box.querySelector("img"), slider = box.querySelector("input"), button = box.querySelector("button");
let timer = null;
const show = () => {{ image.src = "data:image/png;base64," + frames[slider.value]; }};
const pause = () => {{ clearInterval(timer); timer = null; button.innerHTML = "&#9654;"; }};
const next = () => {{ slider.value = (Number(slider.value) + 1) % frames.length; show(); }};
slider.oninput = () => {{ pause(); show(); }};
button.onclick = () => {{
  if (timer) {{ pause(); }} else {{ timer = setInterval(next, {interval}); button.innerHTML = "&#10074;&#10074;"; }}
}};
show();
}})();</script>"""


@dataclass(frozen=True, repr=False)
class Player:
    """An animation as `html`, which notebooks show by themselves; `frames` are those of the run that it has."""

    html: str
    frames: tuple[int, ...]

    def _repr_html_(self) -> str:
        return self.html

    def __repr__(self) -> str:
        return f"Player({len(self.frames)} frames, {len(self.html) / 1e6:.1f} MB)"

    def save(self, path: str | Path) -> Path:
        """Writes a page that browsers open without anything else; replaces a file that is there."""
        path = Path(path)
        path.write_text(f'<!doctype html><meta charset="utf-8">{self.html}', encoding="utf-8")
        return path


def player(
    run: Run,
    color: str = "pressure",
    *,
    fps: float = 25.0,
    dpi: float = 80.0,
    limits: tuple[float, float] | None = None,
    most: int = 100,
) -> Player:
    """An animation with a slider and a button that plays it, as HTML that stands by itself.

    Of a run with more than `most` frames it has so many, evenly chosen, with the first and the last: a frame takes some
    10 to 20 kB of a notebook. `color` and `limits` as in `frame`, `fps` frames per second, `dpi` pixels per inch.
    Raises `ValueError` for a run without frames and for arguments out of their range.
    """
    fps, dpi = positive("fps", fps, "1/s"), positive("dpi", dpi, "1/in")
    if not len(run):
        raise ValueError("run must have frames, got none")
    count = min(len(run), whole("most", most, least=2))
    frames = tuple(np.linspace(0, len(run) - 1, count).round().astype(int).tolist())
    scene = Scene(run, color, limits, range(len(run)))
    scene.figure.set_dpi(dpi)
    page = _PAGE.format(
        name=f"jaxmps-{uuid.uuid4().hex}",
        title=html.escape(" · ".join(["animation", *heading(run)])),
        width=round(scene.figure.get_figwidth() * dpi),
        last=len(frames) - 1,
        interval=round(1000.0 / fps),
        frames=json.dumps([_encoded(image) for image in indexed_pictures(scene, frames)]),
    )
    return Player(page, frames)


def _encoded(image) -> str:
    buffer = io.BytesIO()
    image.save(buffer, format="png", optimize=True)
    return base64.b64encode(buffer.getvalue()).decode()
