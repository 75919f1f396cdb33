"""Pictures of runs, made from a run without any computation."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from jaxmps import plotting
from jaxmps.results import Run

SPACING, FRAMES = 0.1, 4


def make_run(dim: int = 2, frames: int = FRAMES) -> Run:
    """A column of 5 × (2 ×) 10 fluid particles that slides along a floor of walls and dummies."""
    across = [range(2)] * (dim - 2)
    column = np.stack(np.meshgrid(range(5), *across, range(10), indexing="ij"), -1).reshape(-1, dim)
    floor = np.stack(np.meshgrid(range(-1, 21), *across, [-2, -1], indexing="ij"), -1)
    floor = floor.reshape(-1, dim)
    kind = np.concatenate([np.zeros(len(column)), np.where(floor[:, -1] == -1, 1, 2)]).astype(int)
    time = 0.05 * np.arange(frames)
    position = np.tile(SPACING * (np.concatenate([column, floor]) + 0.5), (frames, 1, 1))
    position[:, kind == 0, 0] += 2.0 * time[:, None]
    shape = (frames, len(kind))
    height = np.where(kind == 0, position[..., -1], 0.0)
    velocity = np.zeros((*shape, dim))
    velocity[:, kind == 0, 0] = 2.0
    return Run(
        time=time,
        position=position,
        velocity=velocity,
        pressure=9810.0 * (1.0 - height),
        number_density=np.full(shape, 6.5),
        surface=height > 0.9,
        kind=np.tile(kind, (frames, 1)),
        phase=np.zeros(len(kind), int),
        density=np.full(len(kind), 1000.0),
        spacing=SPACING,
        energy=np.tile([2.0, 4.9], (frames, 1)),
        metadata={
            "case": {"name": "dam_break", "width": 0.5, "gravity": 9.81, "tank_length": 2.0},
            "scheme": {"name": "mps"},
        },
    )


def pixels(figure: Figure, path: Path) -> np.ndarray:
    figure.savefig(path)
    return np.asarray(Image.open(path).convert("RGB"), int)


def test_a_disc_is_as_wide_as_the_spacing_on_the_screen(tmp_path):
    run = make_run()
    figure = plotting.frame(run, 0, "kind")
    ax = figure.axes[0]
    row = pixels(figure, tmp_path / "a.png")
    drop = dataclasses.replace(run, position=run.position.copy())
    drop.position[0, 0] = (0.15, 1.45)  # alone above the rest
    drop.position[0, 1:50] = (0.25, 0.5)
    image = pixels(plotting.frame(drop, 0, "kind", ax=None), tmp_path / "b.png")
    assert image.shape[2] == row.shape[2] == 3
    scene = plotting.frame(drop, 0, "kind").axes[0]
    x, y = scene.transData.transform((0.15, 1.45))
    line = image[image.shape[0] - 1 - round(y), round(x) - 60 : round(x) + 60]
    colored = np.sum(line.sum(axis=-1) < 3 * 200)
    left, right = scene.transData.transform([(0.0, 0.0), (SPACING, 0.0)])[:, 0]
    assert colored == pytest.approx(right - left, abs=2.0)
    assert ax.get_aspect() == 1.0


@pytest.mark.parametrize("color", plotting.COLORS)
@pytest.mark.parametrize("dim", [2, 3])
def test_every_color_is_drawn_with_title_and_unit(tmp_path, color, dim):
    figure = plotting.frame(make_run(dim), 1, color)
    image = pixels(figure, tmp_path / "frame.png")
    assert np.ptp(image) > 150
    ax, bar = figure.axes[0], ([*figure.axes, *figure.axes[0].child_axes])[-1]
    assert ax.get_title(loc="left") == "dam_break · mps · t = 0.050 s"
    assert ax.get_xlabel() == "x [m]"
    units = {"pressure": "[Pa]", "speed": "[m/s]", "number_density": "number density"}
    assert units.get(color, "") in bar.get_ylabel()


def test_a_picture_shows_itself_in_a_notebook():
    assert plotting.frame(make_run())._repr_png_().startswith(b"\x89PNG")  # type: ignore[attr-defined]


def test_a_frame_can_be_drawn_into_axes_of_another_figure():
    figure = Figure()
    ax = figure.add_subplot()
    assert plotting.frame(make_run(), ax=ax) is figure


def test_particles_that_have_left_are_not_drawn():
    run = make_run()
    run.kind[-1, :3] = 3
    fluid = plotting.frame(run, -1).axes[0].collections[-1]
    offsets = np.ma.filled(np.ma.asarray(fluid.get_offsets(), float), np.nan)
    assert np.isnan(offsets).any(axis=1).sum() == 3


@pytest.mark.parametrize("frames", [1, FRAMES])
def test_a_run_at_rest_without_pressure_has_a_color_scale(frames, tmp_path):
    run = make_run(frames=frames)
    run.pressure[:] = 0.0
    plotting.frame(run).savefig(tmp_path / "frame.png")


def test_limits_are_the_ends_of_the_color_scale():
    fluid = plotting.frame(make_run(), limits=(10.0, 20.0)).axes[0].collections[-1]
    assert fluid.get_clim() == (10.0, 20.0)


@pytest.mark.parametrize(
    ("arguments", "fault"),
    [
        ({"color": "red"}, "color must be one of pressure, .* got red"),
        ({"limits": (2.0, 1.0)}, "limits must be .* got 2 and 1"),
        ({"limits": (0.0, float("nan"))}, "limits must be .* got nan"),
    ],
)
def test_a_frame_says_what_is_wrong_with_its_arguments(arguments, fault):
    with pytest.raises(ValueError, match=fault):
        plotting.frame(make_run(), **arguments)


def test_a_frame_that_is_not_there_is_named():
    with pytest.raises(IndexError, match="between -4 and 3, got 4"):
        plotting.frame(make_run(), 4)


@pytest.mark.parametrize("dim", [2, 3])
def test_an_animation_has_every_frame_and_keeps_its_axes(tmp_path, dim):
    path = plotting.animate(make_run(dim), tmp_path / "run.gif", fps=20.0)
    with Image.open(path) as gif:
        assert gif.n_frames == FRAMES  # type: ignore[attr-defined]
        assert gif.info["duration"] == 50
        first = np.asarray(gif.convert("RGB"), int)
        gif.seek(FRAMES - 1)
        last = np.asarray(gif.convert("RGB"), int)
    assert np.any(first != last)
    assert np.all(first[0, 0] == 255)
    below_axes = slice(int(0.94 * len(first)), None)
    assert np.all(first[below_axes] == last[below_axes])


def test_an_animation_of_2000_particles_is_small(tmp_path):
    rng, frames, n = np.random.default_rng(0), 50, 2000
    start = np.stack(np.meshgrid(np.arange(40), np.arange(50)), -1).reshape(-1, 2) * 0.02
    start[-2:] = [(-0.02, 1.98), (2.0, -0.02)]  # corners of a tank
    kind = np.where(np.arange(n) < n - 2, 0, 1)
    drift = 0.004 * rng.normal(size=(frames, n, 2)).cumsum(axis=0)
    run = dataclasses.replace(
        make_run(),
        time=0.02 * np.arange(frames),
        position=start + np.where(kind == 0, 1.0, 0.0)[:, None] * drift,
        pressure=9810.0 * np.tile(1.0 - start[:, 1], (frames, 1)),
        kind=np.tile(kind, (frames, 1)),
        spacing=0.02,
    )
    assert plotting.animate(run, tmp_path / "run.gif").stat().st_size < 2e6


@pytest.mark.parametrize("name", ["run.avi", "run"])
def test_an_animation_names_the_suffixes_that_it_can_write(tmp_path, name):
    with pytest.raises(ValueError, match=rf"out must end in \.gif.* got {name}"):
        plotting.animate(make_run(), tmp_path / name)
    assert not any(tmp_path.iterdir())


def test_energy_is_shown_per_volume_as_well(tmp_path):
    ax = plotting.energy(make_run()).axes[0]
    (volume,) = ax.child_axes
    ax.figure.savefig(tmp_path / "energy.png")
    low, high = ax.get_ylim()
    assert volume.get_ylim() == pytest.approx((1000.0 * low, 1000.0 * high))


def test_energy_shows_three_curves_that_add_up():
    total, potential, kinetic = (line.get_ydata() for line in plotting.energy(make_run()).axes[0].lines)
    np.testing.assert_allclose(np.asarray(total, float), np.add(potential, kinetic))


def test_front_shows_the_run_with_measurements_in_units_of_the_column():
    pytest.importorskip("jax")
    run, *data = plotting.front(make_run()).axes[0].lines
    time, place = np.asarray(run.get_data(), float)
    np.testing.assert_allclose(place, 1.0 + 2.0 * 0.05 * np.arange(FRAMES) / 0.5)
    np.testing.assert_allclose(time, 0.05 * np.arange(FRAMES) * np.sqrt(2.0 * 9.81 / 0.5))
    assert len(data) == 3


def test_front_is_for_dam_breaks_only():
    run = dataclasses.replace(make_run(), metadata={"case": {"name": "hydrostatic"}})
    with pytest.raises(ValueError, match=r"dam break.* got the case hydrostatic"):
        plotting.front(run)
