"""Animations of runs, as GIF or MP4."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from jaxmps.plotting.colors import INK
from jaxmps.plotting.flow import Scene
from jaxmps.results import Run
from jaxmps.validation import positive

_LAST = 1000  # how long a GIF rests on its last frame, in ms


def animate(
    run: Run,
    out: str | Path,
    color: str = "pressure",
    *,
    fps: float = 25.0,
    dpi: float = 100.0,
    limits: tuple[float, float] | None = None,
) -> Path:
    """Writes all frames to `out`, a GIF or, with ffmpeg installed, an MP4; `fps` per second.

    Axes and color scale stay fixed; `limits` are the values at the ends of the scale, by default
    percentiles of the run. Raises `ValueError` for another suffix, and for an MP4 without ffmpeg.
    """
    from matplotlib.animation import FFMpegWriter

    out = Path(out)
    fps, dpi = positive("fps", fps, "1/s"), positive("dpi", dpi, "1/in")
    suffix = out.suffix.lower()
    if suffix not in (".gif", ".mp4") or (suffix == ".mp4" and not FFMpegWriter.isAvailable()):
        raise ValueError(f"out must end in .gif, or in .mp4 where ffmpeg is installed, got {out.name}")
    if not len(run):
        raise ValueError("run must have frames, got none")
    scene = Scene(run, color, limits, range(len(run)))
    scene.figure.set_dpi(dpi)
    if suffix == ".gif":
        _write_gif(scene, out, fps)
    else:
        writer = FFMpegWriter(fps=fps)  # type: ignore[arg-type]
        with writer.saving(scene.figure, str(out), dpi):
            for index in range(len(run)):
                scene.show(index)
                writer.grab_frame()
    return out


def indexed_pictures(scene: Scene, frames: Iterable[int]) -> Iterator[Any]:
    """Pictures of the frames, as images of one palette."""
    colors = _palette(scene.colormap, shaded=scene.axes.name != "3d" and scene.run.position.shape[2] == 3)
    table = _nearest(colors)
    return (_indexed(pixels, colors, table) for pixels in _pictures(scene, frames))


def _write_gif(scene: Scene, path: Path, fps: float) -> None:
    # GIF counts in hundredths of a second, and viewers slow down below two.
    duration = 10 * max(round(100.0 / fps), 2)
    frames = indexed_pictures(scene, range(len(scene.run)))
    durations = [duration] * (len(scene.run) - 1) + [max(duration, _LAST)]
    next(frames).save(path, save_all=True, append_images=frames, duration=durations, loop=0, disposal=1)


def _pictures(scene: Scene, frames: Iterable[int]) -> Iterator[np.ndarray]:
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    canvas = FigureCanvasAgg(scene.figure)
    moving = scene.moving
    if moving:
        # What stays is drawn once.
        for artist in moving:
            artist.set_animated(True)
        canvas.draw()
        still = canvas.copy_from_bbox(scene.figure.bbox)
    for index in frames:
        scene.show(index)
        if moving:
            canvas.restore_region(still)
            for artist in moving:
                scene.axes.draw_artist(artist)
        else:
            canvas.draw()
        yield np.asarray(canvas.buffer_rgba())[..., :3]


def _palette(colormap: Any, shaded: bool) -> np.ndarray:
    """The color map, fading into white and, where balls are shaded, into black; greys, and the color of probes. One
    palette, so that nothing flickers.
    """
    from matplotlib.colors import to_rgb

    hues = 255.0 * colormap(np.linspace(0.0, 1.0, 32 if shaded else 48))[:, :3]
    ink = 255.0 * np.array([to_rgb(INK)])
    shades = [part * hue for hue in (hues, ink) for part in (0.85, 0.7, 0.5)] if shaded else []
    faded = [hues + (255.0 - hues) * part for part in (0.0, 0.5)]
    greys = np.repeat(np.linspace(0.0, 255.0, 24)[:, None], 3, axis=1)
    return np.concatenate([*faded, greys, ink, *shades]).round().astype(np.uint8)


def _nearest(colors: np.ndarray) -> np.ndarray:
    """Index of the nearest color of the palette for 32 levels of red, green and blue."""
    levels = np.linspace(0.0, 255.0, 32)
    distance = [(levels[:, None] - channel) ** 2 for channel in colors.T.astype(float)]
    red, green, blue = distance
    flat = [(r + green[:, None] + blue[None]).argmin(axis=-1) for r in red]
    return np.array(flat, np.uint8)


def _indexed(pixels: np.ndarray, colors: np.ndarray, table: np.ndarray) -> Any:
    from PIL import Image

    red, green, blue = np.moveaxis(pixels >> 3, -1, 0)
    image = Image.fromarray(table[red, green, blue])
    image.putpalette(colors.tobytes())
    return image
