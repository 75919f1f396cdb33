"""Walls of own geometries: plates, walls that would vanish, solids from STL files, sizes, and walls that leave."""

import math
import re

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from hasty import by_diagonal
from scipy.spatial import KDTree
from test_casefile import GOOD, TANK, alone, call, file, places, precision_is_restored  # noqa: F401

import jaxmps as mps
from jaxmps import Kind, casefile, cases, simulate
from jaxmps.casefile import CaseFileError, meshes, read, solid
from jaxmps.kernels import lattice
from jaxmps.motion import Bodies, Rigid, Sine
from jaxmps.pressure.multigrid.grid import cover

DOWN = "[0.0, 0.0, -9.81]"
PARTED = """
[case]
spacing = 0.05
gravity = [0.0, -9.81]
[[fluid]]
density = 1000.0
[[fluid.body]]
box = [[0.0, 0.0], [0.4, 0.4]]
[[wall]]
box = [[0.0, 0.0], [1.0, 0.6]]
side = "outside"
open = ["+y"]
[[wall]]
{wall}
"""
SPACE = """
[case]
spacing = 0.1
gravity = [0.0, 0.0, -9.81]
[[fluid]]
density = 1000.0
[[fluid.body]]
box = [[0.0, 0.0, 0.0], [1.4, 0.4, 0.4]]
[[wall]]
box = [[0.0, 0.0, 0.0], [1.4, 0.4, 0.6]]
side = "outside"
open = ["+z"]
[[wall]]
{wall}
"""


def arrays(case) -> tuple[np.ndarray, np.ndarray]:
    return np.asarray(case.particles.position), np.asarray(case.particles.kind)


def fault(path) -> str:
    with pytest.raises(CaseFileError) as caught:
        read(path)
    (line,) = caught.value.faults
    return line


def test_a_plate_parts_a_tank_and_water_stays_on_its_side(file):  # noqa: F811
    setup = read(file(PARTED.format(wall="box = [[0.495, 0.0], [0.505, 0.6]]\nplate = true")))
    assert not casefile.check(setup).warnings
    position, kind = arrays(setup.case)
    # 2.1 spacings: a wall on either side and two dummies between them, four spacings about x = 0.5.
    row = (np.abs(position[:, 1] - 0.325) < 0.01) & (np.abs(position[:, 0] - 0.5) < 0.12) & (kind != Kind.FLUID)
    order = np.argsort(position[row, 0])
    np.testing.assert_allclose(position[row][order, 0], [0.425, 0.475, 0.525, 0.575])
    assert kind[row][order].tolist() == [Kind.WALL, Kind.DUMMY, Kind.DUMMY, Kind.WALL]
    run = simulate(setup.case, by_diagonal(setup.scheme), until=0.4, save_every=0.1, progress=False)
    assert run.status.completed and run.fluid[-1].sum() == 64
    assert run.position[-1][run.fluid[-1], 0].max() < 0.425
    right = (kind != Kind.FLUID) & (position[:, 0] > 0.56)
    assert not run.pressure[-1, right].any(), "the dry side feels nothing"
    assert run.pressure[-1, (kind == Kind.WALL) & (np.abs(position[:, 0] - 0.425) < 0.01)].max() > 1000.0


@pytest.mark.parametrize(("center", "ratio"), [(0.7, 2.1), (0.65, 2.1), (0.68, 2.1), (0.7, 3.1)])
def test_fluid_and_walls_on_both_sides_of_a_plate_in_space_have_whole_neighborhoods(file, center, ratio):  # noqa: F811
    high = SPACE.replace("0.4]]", "1.0]]").replace("0.6]]", "1.2]]")
    text = high.format(wall=f"box = [[{center - 0.001}, 0.0, 0.0], [{center + 0.001}, 0.4, 1.2]]\nplate = true")
    position, kind = arrays(read(file(text + f"[scheme]\nratio = {ratio}\n")).case)
    reach, rows = ratio * 0.1, math.ceil(ratio) + 1
    plate = (kind != Kind.FLUID) & (position[:, 2] > 0.0) & (np.abs(position[:, 0] - 0.7) < 0.4)
    places = np.unique(np.round(position[plate & (position[:, 1] > 0.0) & (position[:, 1] < 0.4), 0], 6))
    assert len(places) == rows and np.abs(places.mean() - center) <= 0.05 + 1e-9
    # Away from floor and surface: the first fluid and the walls on either side.
    here = (position[:, 1] > 0.0) & (position[:, 1] < 0.4) & (np.abs(position[:, 2] - 0.5) < 0.1)
    left, right = (
        np.flatnonzero(here & (kind != Kind.DUMMY) & (sign * (position[:, 0] - places.mean()) > 0)) for sign in (-1, 1)
    )
    assert KDTree(position[right]).query(position[left])[0].min() >= reach
    for side, face in ((left, places[0]), (right, places[-1])):
        near = side[np.abs(position[side, 0] - face) < 0.11]
        assert {int(k) for k in kind[near]} == {Kind.FLUID, Kind.WALL}
        found = KDTree(position).query_ball_point(position[near], reach)
        assert {len(seen) - 1 for seen in found} == {lattice(ratio, 3).neighbors}


def test_a_polyline_can_be_a_plate_about_it_or_to_one_side(file):  # noqa: F811
    line = "polyline = [[0.7, 0.05], [0.7, 0.55]]\nplate = true\n"
    for side, low, high in (("", 0.6, 0.8), ('side = "left"', 0.5, 0.7), ('side = "right"', 0.7, 0.9)):
        position, kind = arrays(read(file(PARTED.format(wall=line + side))).case)
        plate = (kind != Kind.FLUID) & np.all((position > [0.45, 0.0]) & (position < [0.95, 0.6]), axis=1)
        x = np.unique(np.round(position[plate, 0], 6))
        np.testing.assert_allclose(x, low + 0.05 * np.array([0.5, 1.5, 2.5, 3.5]), atol=1e-6)
        outer = np.abs(np.abs(position[:, 0] - 0.5 * (low + high)) - 0.075) < 1e-6
        assert np.all(kind[plate & outer] == Kind.WALL)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            PARTED.format(wall='box = [[0.5, 0.0], [0.52, 0.6]]\nside = "inside"'),
            r"\[\[wall\]\] 2: must be at least as thick as the spacing 0.05 m .* got 0.02 m.* plate = true",
        ),
        (
            PARTED.format(wall='polygon = [[0.5, 0.0], [0.53, 0.0], [0.63, 0.6], [0.6, 0.6]]\nside = "inside"'),
            r"\[\[wall\]\] 2: must be at least as thick .* got 0.0296 m.* as a box or a polyline with plate = true",
        ),
        (
            SPACE.format(wall='box = [[0.7, 0.0, 0.0], [0.703, 0.4, 0.6]]\nside = "inside"'),
            r"\[\[wall\]\] 2: must be at least as thick as the spacing 0.1 m .* got 0.003 m",
        ),
        (
            PARTED.format(wall='box = [[0.6, 0.0], [0.8, 0.2]]\nside = "outside"\nopen = ["-x", "+x", "-y", "+y"]'),
            r"\[\[wall\]\] 2: must have room for a particle",
        ),
        (
            PARTED.format(wall="box = [[0.5, 0.0], [0.52, 0.6]]\nplate = true\nthickness = 0.1"),
            r"\[\[wall\]\] 2: a plate must be at least 4 layers, 0.2 m, thick at the spacing 0.05 m, got 0.1 m",
        ),
        (
            PARTED.format(wall="circle = { center = [0.7, 0.3], radius = 0.1 }\nplate = true"),
            r"\[\[wall\]\] 2: plate must be given with a box or a polyline, got a circle",
        ),
        (
            PARTED.format(wall='box = [[0.5, 0.0], [0.52, 0.6]]\nplate = true\nside = "outside"'),
            r"\[\[wall\]\] 2: side must be inside for a plate, got outside",
        ),
        (
            PARTED.format(wall="polyline = [[0.6, 0.1], [0.9, 0.1], [0.9, 0.5], [0.6, 0.5], [0.6, 0.1]]\nplate = true"),
            r"\[\[wall\]\] 2: the polyline of a plate must not close",
        ),
    ],
)
def test_a_wall_that_would_vanish_is_refused_with_its_thickness_and_the_spacing(file, text, words):  # noqa: F811
    assert re.search(words, fault(file(text)))


def test_check_warns_of_a_wall_through_which_fluid_feels_the_other_side(file):  # noqa: F811
    thin = read(file(PARTED.format(wall='box = [[0.475, 0.0], [0.525, 0.6]]\nside = "inside"')))
    assert any("wall 2 is 0.05 m thick: fluid on one side" in line for line in casefile.check(thin).warnings)


@pytest.mark.parametrize("dim", [2, 3])
def test_check_warns_of_a_part_of_a_wall_that_has_no_particles(file, tmp_path, dim):  # noqa: F811
    if dim == 2:  # a block of 0.2 m with a fin of 0.02 m
        corners = "[[0.6, 0.0], [0.8, 0.0], [0.8, 0.2], [0.71, 0.2], [0.71, 0.5], [0.69, 0.5], [0.69, 0.2], [0.6, 0.2]]"
        text = PARTED.format(wall=f'polygon = {corners}\nside = "inside"')
    else:
        bounds = ([0.5, 0.0, 0.0], [0.9, 0.4, 0.2]), ([0.66, 0.0, 0.1], [0.68, 0.4, 0.6])
        written(tmp_path, cubes(*bounds))
        text = SPACE.format(wall='stl = "body.stl"\nside = "inside"')
    warnings = casefile.check(read(file(text))).warnings
    (line,) = [line for line in warnings if line.startswith("wall 2 has no particles at (0.")]
    assert "thinner than a spacing: fluid flows through" in line


@pytest.mark.parametrize(("left", "right"), [(0.45, 0.95), (0.4, 0.9), (0.42, 0.92), (0.65, 0.75), (0.6, 0.7)])
def test_a_block_has_as_many_rows_as_spacings_wherever_it_lies_and_walls_on_its_faces(file, left, right):  # noqa: F811
    wall = f'box = [[{left}, 0.0, 0.0], [{right}, 0.4, 0.6]]\nside = "inside"'
    position, kind = arrays(read(file(SPACE.format(wall=wall))).case)
    row = (np.abs(position[:, 1] - 0.25) < 0.01) & (np.abs(position[:, 2] - 0.25) < 0.01) & (kind != Kind.FLUID)
    row &= np.abs(position[:, 0] - 0.7) < 0.6
    kinds = kind[row][np.argsort(position[row, 0])]
    assert len(kinds) == round((right - left) / 0.1)
    assert kinds[0] == kinds[-1] == Kind.WALL


def test_a_block_of_the_plane_as_thick_as_a_spacing_has_one_row(file):  # noqa: F811
    for left in (0.5, 0.475, 0.48):
        wall = f'box = [[{left}, 0.0], [{left + 0.05}, 0.6]]\nside = "inside"'
        position, kind = arrays(read(file(PARTED.format(wall=wall))).case)
        row = (kind == Kind.WALL) & (np.abs(position[:, 0] - 0.5) < 0.1) & (position[:, 1] > 0.0)
        np.testing.assert_allclose(position[row, 0], left + 0.025, atol=2e-3 * 0.05)
        assert len(position[row]) == 12


CUBES = ([0.0, 0.0, 0.0], [1.0, 1.0, 1.0]), ([0.6, 0.0, 0.0], [1.6, 1.0, 1.0])


def cubes(*bounds) -> list[trimesh.Trimesh]:
    return [trimesh.creation.box(bounds=corners) for corners in bounds]


def written(folder, parts: list[trimesh.Trimesh], name: str = "body.stl") -> None:
    trimesh.util.concatenate(parts).export(folder / name)


def filled(file, stl: str = "body.stl", more: str = "") -> np.ndarray:  # noqa: F811
    return np.asarray(read(file(alone(f'stl = "{stl}"\n{more}', 0.1, DOWN))).case.particles.position)


def test_solids_of_an_stl_file_that_overlap_are_full_where_they_do(file, tmp_path):  # noqa: F811
    written(tmp_path, cubes(*CUBES))
    position = filled(file)
    assert len(position) == 16 * 10 * 10  # of the union, 1.6 m³
    assert len({tuple(row) for row in np.round(position, 3).tolist()}) == len(position)
    assert np.sum((position[:, 0] > 0.6) & (position[:, 0] < 1.0)) == 4 * 10 * 10
    found = meshes.solid(casefile.shapes.Shape(stl="body.stl"), tmp_path)  # type: ignore[attr-defined]
    assert solid.volume(found, 0.1) == pytest.approx(1.6)


def test_a_tank_of_two_boxes_that_overlap_has_no_wall_inside(file, tmp_path):  # noqa: F811
    written(tmp_path, cubes(([0.0, 0.0, 0.0], [0.8, 0.4, 0.6]), ([0.6, 0.0, 0.0], [1.4, 0.4, 0.6])))
    text = SPACE.replace(
        'box = [[0.0, 0.0, 0.0], [1.4, 0.4, 0.6]]\nside = "outside"', 'stl = "body.stl"\nside = "outside"'
    )
    whole, made = (read(file(t.replace("[[wall]]\n{wall}\n", ""))).case for t in (SPACE, text))
    assert places(whole) == places(made)


def test_a_surface_turned_inward_is_a_hole_and_a_body_turned_inward_is_none(file, tmp_path):  # noqa: F811
    outer, inner = cubes(([0.0, 0.0, 0.0], [1.0, 1.0, 1.0]), ([0.3, 0.3, 0.3], [0.7, 0.7, 0.7]))
    inner.invert()
    written(tmp_path, [outer, inner])
    assert len(filled(file)) == 1000 - 64
    one, other = cubes(([0.0, 0.0, 0.0], [0.5, 0.5, 0.5]), ([0.3, 0.0, 0.0], [0.8, 0.5, 0.5]))
    other.invert()
    written(tmp_path, [one, other])
    assert len(filled(file)) == 8 * 5 * 5


def blocks(*parts: str) -> str:
    return "\n".join(f"solid part {k}\n{part}\nendsolid part {k}" for k, part in enumerate(parts))


def facets(found: trimesh.Trimesh) -> list[str]:
    lines = trimesh.exchange.stl.export_stl_ascii(found).splitlines()[1:-1]
    return ["\n".join(lines[k : k + 7]) for k in range(0, len(lines), 7)]


def test_the_blocks_of_an_stl_file_are_one_surface_together(file, tmp_path):  # noqa: F811
    (whole,) = cubes(CUBES[0])
    made = facets(whole)
    (tmp_path / "body.stl").write_text(blocks("\n".join(made[:5]), "\n".join(made[5:])))
    assert len(filled(file)) == 1000
    (tmp_path / "body.stl").write_text(blocks("\n".join(made[:5]), "\n".join(made[6:])))
    assert "must be watertight" in fault(file(alone('stl = "body.stl"', 0.1, DOWN)))
    # Two closed blocks side by side, with a face in common, and two that overlap.
    beside = cubes(([0.0, 0.0, 0.0], [0.5, 0.5, 0.5]), ([0.5, 0.0, 0.0], [1.0, 0.5, 0.5]))
    (tmp_path / "body.stl").write_text(blocks(*("\n".join(facets(part)) for part in beside)))
    assert len(filled(file)) == 10 * 5 * 5
    written(tmp_path, beside, "one.stl")
    assert len(filled(file, "one.stl")) == 10 * 5 * 5
    (tmp_path / "body.stl").write_text(blocks(*("\n".join(facets(part)) for part in cubes(*CUBES))))
    assert len(filled(file)) == 1600


def test_shapes_that_are_too_large_are_told_in_spacings_before_anything_is_made(file, tmp_path):  # noqa: F811
    written(tmp_path, cubes(([0.0, 0.0, 0.0], [400.0, 200.0, 500.0])), "mm.stl")
    line = fault(file(alone('stl = "mm.stl"', 0.02, DOWN)))
    assert "[[fluid]] 1, [[fluid.body]] 1: stl" in line and "400 x 200 x 500 m" in line
    assert "2e+04 x 1e+04 x 2.5e+04 spacings of 0.02 m" in line and "scale = 0.001" in line
    assert len(filled(file, "mm.stl", "scale = 0.001")) == 4 * 2 * 5
    line = fault(file(alone("box = [[0.0, 0.0], [1e4, 1e4]]", 0.02)))
    assert "box must be at most" in line and "5e+05 x 5e+05 spacings" in line
    line = fault(
        file(
            GOOD.replace(
                'box = [[0.0, 0.0], [0.4, 0.6]]\nside = "outside"', 'polyline = [[0.0, 0.0], [1e6, 1e6]]\nside = "left"'
            )
        )
    )
    assert "[[wall]] 1: polyline must be at most" in line
    far = (
        alone("box = [[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]]", 0.1, DOWN)
        + "[[fluid.body]]\nbox = [[1e3, 1e3, 1e3], [1001.0, 1001.0, 1001.0]]\n"
    )
    assert "[case]: spacing must leave at most" in fault(file(far))
    line = fault(file(GOOD.replace("spacing = 0.05", "spacing = 0.05\nlower = [-1.0, -1.0]\nupper = [1e5, 1e5]")))
    assert "[case]: the domain must have at most" in line and "2e+06 x 2e+06" in line
    with pytest.raises(ValueError, match="the box must have at most"):
        cover(mps.Box((0.0, 0.0), (1e5, 1e5)), 0.1)
    with pytest.raises(ValueError, match=r"spacing must leave at most .* lattice points, got 4"):
        cases.dam_break(spacing=1e-6)


MOVING = TANK.format(
    body="box = [[0.0, 0.0], [0.4, 0.4]]",
    wall='box = [[0.0, 0.0], [0.4, 0.6]]\nside = "outside"\nopen = ["+y"]\n'
    '[[wall]]\nbox = [[0.1, 0.1], [0.2, 0.2]]\nside = "inside"',
).replace("gravity", "lower = [-0.3, -0.3]\nupper = [0.7, 2.0]\ngravity")


def test_a_wall_that_is_to_leave_the_domain_is_told_with_time_and_body(file, tmp_path, monkeypatch):  # noqa: F811
    monkeypatch.chdir(tmp_path)
    # Its last row at x = 0.525 m has 0.175 m to the edge of the domain: a quarter of the way from 0.1 to 0.4 m.
    sway = '[motion]\nsway = { times = [0.0, 0.5, 1.0], values = [0.0, 0.1, 0.4], interpolation = "linear" }\n'
    path = file(MOVING + sway)
    gone = casefile.leaving(read(path))
    assert gone is not None and gone.body == "[[wall]] 1"
    assert gone.time == pytest.approx(0.625, rel=1e-6)
    assert gone.place[0] == pytest.approx(0.7)
    code, _, err = call("check", path)
    assert code == 0 and "warning: [[wall]] 1 leaves the domain at t = 0.625 s" in err
    code, _, err = call("run", path)
    assert code == 2 and err.startswith("error: [[wall]] 1 leaves the domain at t = 0.625 s")
    assert not (tmp_path / "my").exists()
    assert casefile.leaving(read(file(MOVING + sway + "[run]\nuntil = 0.62\n"))) is None


def test_of_several_bodies_the_one_that_leaves_is_named(file):  # noqa: F811
    setup = read(file("[case]\nbuiltin = 'hydrostatic'\nspacing = 0.1\n[run]\nuntil = 3.0\n"))
    position, kind = arrays(setup.case)
    body = np.where(kind == Kind.FLUID, 0, np.where(position[:, 0] < 0.0, 0, 1))
    # A fast sine of 0.02 m has its first maximum after a quarter of its period.
    still, shaking = Rigid([0.0, 0.0]), Rigid([0.0, 0.0], sway=Sine(0.02, 2.0 * math.pi / 0.04))
    high = float(position[:, 0].max()) + 0.0199
    case = eqx.tree_at(lambda c: c.motion, setup.case, Bodies((still, shaking), jnp.asarray(body)))
    case = mps.Case(
        particles=case.particles,
        fluids=case.fluids,
        gravity=case.gravity,
        spacing=case.spacing,
        box=mps.Box((-1.0, -1.0), (high, 3.0)),
        motion=case.motion,
    )
    gone = casefile.leaving(casefile.Setup(case, setup.scheme, (), setup.run))
    assert gone is not None and gone.body == "body 1 of the motion"
    assert gone.time == pytest.approx(0.04 / (2.0 * math.pi) * math.asin(0.0199 / 0.02), rel=1e-6)
