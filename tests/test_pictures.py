"""What pictures show of walls that move, of space, and of probes; signs of pressures and names of phases."""

import dataclasses
import math

import numpy as np
import pytest
from PIL import Image
from test_plotting import make_run, pixels

from jaxmps import plotting
from jaxmps.flow import Event, Kind, Outcome, Status
from jaxmps.plotting import rendered
from jaxmps.plotting.flow import Scene
from jaxmps.plotting.shell import carried, shell
from jaxmps.results import Run

TURN = math.radians(12.0)  # of the floor, from frame to frame


def turned(points: np.ndarray, angle: float) -> np.ndarray:
    """Points turned about the origin, from the first axis to the last."""
    x, z = points[..., 0], points[..., -1]
    made = points.copy()
    made[..., 0], made[..., -1] = np.cos(angle) * x - np.sin(angle) * z, np.sin(angle) * x + np.cos(angle) * z
    return made


def rolling(dim: int = 2, probes: tuple = ()) -> Run:
    """The sliding column, whose floor turns away under it."""
    run = make_run(dim)
    walls = run.kind[0] != Kind.FLUID
    for k in range(len(run)):
        run.position[k, walls] = turned(run.position[0, walls], k * TURN)
    return dataclasses.replace(run, metadata={**run.metadata, "case": {"name": "rolling", "probes": probes}})


def drawn_walls(axes) -> np.ndarray:
    """Where the walls (not the dummies) of the 22 in the run are drawn: they come second, the fluid third."""
    return np.asarray(axes.collections[1].get_offsets())


@pytest.mark.parametrize("index", [0, 2, 3])
def test_a_frame_has_its_walls_where_they_are_at_its_time(index):
    run = rolling()
    walls = run.kind[0] == Kind.WALL
    figure = plotting.frame(run, index)
    np.testing.assert_allclose(drawn_walls(figure.axes[0]), turned(run.position[0, walls], index * TURN))
    left, right = figure.axes[0].get_xlim()
    seen = run.position[index, :, 0]
    assert left < seen.min() and seen.max() < right


def test_panels_and_the_picture_of_a_failure_have_their_walls_where_they_are():
    run = rolling()
    walls = run.kind[0] == Kind.WALL
    figure = plotting.panels([run], [0.0, 0.15])
    for axes, index in zip(figure.axes, (0, 3), strict=False):
        np.testing.assert_allclose(drawn_walls(axes), turned(run.position[0, walls], index * TURN))
        low, high = np.array([axes.get_xlim(), axes.get_ylim()]).T
        assert np.all(run.position[3] > low) and np.all(run.position[3] < high)
    near = run.position[-1, 0]
    event = Event(int(Status.NOT_FINITE), 0.15, 3, 0, tuple(near.tolist()))
    figure = plotting.failure(dataclasses.replace(run, status=Outcome((event,))))
    expected = turned(run.position[0, walls], 3 * TURN)
    expected = expected[np.abs(expected - near).max(axis=1) <= 15.0 * run.spacing]
    np.testing.assert_allclose(drawn_walls(figure.axes[0]), expected)


def test_an_animation_and_a_player_move_their_walls(tmp_path):
    run = rolling()
    scene = Scene(run, "pressure", None, range(len(run)))
    end = int(np.flatnonzero(run.kind[0] == Kind.WALL)[-1])  # at the far end of the floor
    places = [scene.axes.transData.transform(run.position[k, end]) for k in (0, 3)]
    plotting.animate(run, tmp_path / "run.gif")
    with Image.open(tmp_path / "run.gif") as gif:
        gif.seek(len(run) - 1)
        image = np.asarray(gif.convert("RGB"), int)
    before, now = (image[len(image) - 1 - round(y), round(x)] for x, y in places)
    assert np.all(before > 250), "white where the wall was"
    assert np.ptp(now) < 30 and now.mean() < 160, "grey where it is"
    steady = dataclasses.replace(run, position=np.tile(run.position[:1], (len(run), 1, 1)))
    assert plotting.player(run).html.count("iVBOR") == plotting.player(steady).html.count("iVBOR") == len(run)
    assert len(Scene(run, "kind", None, range(4)).moving) > len(Scene(steady, "kind", None, range(4)).moving)


def box(size: tuple[int, int, int], corner: tuple[int, int, int] = (0, 0, 0)) -> np.ndarray:
    """Lattice points on the faces of a box with so many along each edge."""
    points = np.stack(np.meshgrid(*map(range, size), indexing="ij"), -1).reshape(-1, 3)
    faces = np.any((points == 0) | (points == np.array(size) - 1), axis=1)
    return points[faces] + np.array(corner)


def walled(points: np.ndarray) -> Run:
    """The column in space, and walls at these lattice points instead of its floor."""
    run = make_run(3)
    column = run.position[:, run.kind[0] == Kind.FLUID]
    fluid = column.shape[1]
    walls = np.tile(run.spacing * (points + 0.5), (len(run), 1, 1))
    count = fluid + len(points)
    kind = np.where(np.arange(count) < fluid, Kind.FLUID, Kind.WALL)
    shape = (len(run), count)
    return dataclasses.replace(
        run,
        position=np.concatenate([column, walls], axis=1),
        velocity=np.zeros((*shape, 3)),
        pressure=np.zeros(shape),
        number_density=np.zeros(shape),
        surface=np.zeros(shape, bool),
        kind=np.tile(kind, (len(run), 1)),
        phase=np.zeros(count, int),
        density=np.full(count, 1000.0),
    )


def test_the_shell_of_a_box_has_its_six_faces_and_twelve_edges():
    a, b, c = 7, 5, 4
    found = shell(walled(box((a, b, c))), 0)
    assert len(found.squares) == 2 * ((a - 1) * (b - 1) + (b - 1) * (c - 1) + (a - 1) * (c - 1))
    assert len(found.edges) == 4 * (a - 1 + b - 1 + c - 1)
    assert not len(found.loose)


def test_walls_off_every_lattice_are_shown_one_by_one():
    points = np.random.default_rng(0).uniform(0.0, 5.0, (30, 3))
    found = shell(walled(points), 0)
    assert not len(found.squares)
    assert len(found.loose) == 30


def test_probes_go_with_their_walls():
    run = rolling(3)
    points = np.array([[0.7, 0.1, 0.3], [0.2, 0.2, 0.0]])
    np.testing.assert_allclose(carried(run, points, 2), turned(points, 2 * TURN), atol=1e-12)
    np.testing.assert_array_equal(carried(make_run(3), points, 2), points)


@pytest.fixture(params=["pyvista", "matplotlib"])
def painter(request, monkeypatch):
    if request.param == "matplotlib":
        monkeypatch.setattr(rendered, "available", lambda: False)
    elif not rendered.available():
        pytest.skip("PyVista is missing, or cannot draw here")
    return request.param


def test_pictures_of_space_show_walls_obstacles_and_probes_with_and_without_pyvista(painter, tmp_path):
    obstacle = box((4, 3, 5), (12, 0, 0))
    tank = np.concatenate([box((20, 8, 12), (-1, -1, -1)), obstacle])
    lone = np.array([[-1, -1, -1], [18, 6, 10]])  # of the tank two corners, which keep what is seen
    probe = ("sensor", "pressure", ((1.0, 0.4, 0.9),), None)
    images = {}
    for name, points, probes in (
        ("all", tank, (probe,)),
        ("without probe", tank, ()),
        ("without obstacle", tank[: -len(obstacle)], ()),
        ("bare", lone, ()),
    ):
        run = walled(points)
        run = dataclasses.replace(run, metadata={"case": {"name": "box", "probes": probes}})
        figure = plotting.frame(run, 0)
        assert (figure.axes[0].name == "3d") == (painter == "matplotlib")
        images[name] = pixels(figure, tmp_path / "picture.png")

    def change(one: str, other: str) -> int:
        return int(np.sum(np.abs(images[one] - images[other]).max(axis=2) > 20))

    red = lambda image: np.sum((image[..., 0] > 150) & (image[..., 1:].max(axis=2) < 110))  # noqa: E731
    assert red(images["all"]) > 20 and red(images["without probe"]) == 0
    assert change("without probe", "without obstacle") > 150
    assert change("without obstacle", "bare") > 800


def test_walls_and_fluid_of_space_move_in_its_pictures_and_animations(painter, tmp_path):
    run = rolling(3)
    fluid = run.kind[0] == Kind.FLUID
    for moving in (fluid, ~fluid):
        one = dataclasses.replace(run, position=run.position.copy())
        one.position[:, ~moving] = run.position[:1, ~moving]
        scene, images = Scene(one, "kind", None, range(len(run))), []
        for index in (0, 3):
            scene.show(index)
            images.append(pixels(scene.figure, tmp_path / "picture.png"))
        assert np.sum(np.abs(images[1] - images[0]).max(axis=2) > 20) > 500
        plotting.animate(one, tmp_path / "run.gif", "kind")
        with Image.open(tmp_path / "run.gif") as gif:
            gif.seek(len(run) - 1)
            last = np.asarray(gif.convert("RGB"), int)
        drawn = Scene(one, "kind", None, range(len(run)))
        drawn.show(3)
        # In the colors of the palette, the picture of the last frame: rulers, walls, fluid and names.
        wrong = np.abs(last - pixels(drawn.figure, tmp_path / "picture.png")).max(axis=2) > 80
        assert np.sum(wrong) < 300


def test_a_pressure_of_both_signs_has_zero_in_the_middle_of_its_colors():
    run = make_run()
    run.pressure[:] = np.linspace(-300.0, 900.0, run.pressure.shape[1])
    scene = Scene(run, "pressure", None, range(1))
    norm, colors = scene._norm, scene.colormap
    assert norm(0.0) == 0.5 and norm.vmin == -norm.vmax < -300.0
    red, _, blue, _ = colors(norm(200.0))
    assert red > blue and colors(norm(-200.0))[2] > colors(norm(-200.0))[0]
    chosen = Scene(run, "pressure", (-100.0, 400.0), range(1))._norm
    assert (chosen.vmin, chosen.vmax, chosen(0.0)) == (-100.0, 400.0, 0.5)
    run.pressure[:] = np.abs(run.pressure)
    assert Scene(run, "pressure", None, range(1)).colormap.name == "water"


def test_phases_have_their_names_in_pictures_and_for_other_programs():
    run = make_run()
    run = dataclasses.replace(
        run,
        phase=np.arange(len(run.phase)) % 2,
        metadata={"case": {"name": "layers", "fluids": ["sea water", "oil"]}},
    )
    assert run.phase_names == ["sea water", "oil"]
    (bar,) = plotting.frame(run, 0, "phase").axes[0].child_axes
    assert [label.get_text() for label in bar.get_yticklabels()] == ["sea water", "oil"]
    pytest.importorskip("xarray")
    phase = run.to_xarray().phase.attrs
    assert (phase["flag_meanings"], phase["flag_values"].tolist()) == ("sea_water oil", [0, 1])
    pytest.importorskip("pyvista")
    assert list(run.to_pyvista().field_data["phase_names"]) == ["sea water", "oil"]
    assert dataclasses.replace(run, metadata={}).phase_names == ["phase 0", "phase 1"]
