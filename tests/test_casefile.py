"""Case files: own geometries filled and walled, built-in cases from their templates, and what is said of faults."""

import contextlib
import csv
import dataclasses
import io
import math
import tomllib
from pathlib import Path

import equinox as eqx
import jax
import numpy as np
import pytest
import trimesh
from hasty import by_diagonal
from scipy.spatial import KDTree

from jaxmps import Kind, casefile, cases, schemes, simulate
from jaxmps.casefile import CaseFile, CaseFileError, read, template
from jaxmps.casefile.arguments import case_factories, scheme_factories
from jaxmps.command_line import main

TANK = """
[case]
spacing = 0.05
gravity = [0.0, -9.81]

[[fluid]]
density = 1000.0
[[fluid.body]]
{body}

[[wall]]
{wall}
"""
L_SHAPE = "[[0.0, 0.0], [1.0, 0.0], [1.0, 0.4], [0.4, 0.4], [0.4, 1.0], [0.0, 1.0]]"
EXAMPLE = Path(__file__).parents[1] / "examples" / "cases" / "l_shaped_tank.toml"


@pytest.fixture
def file(tmp_path):
    """Writes a case file and gives its path."""

    def write(text: str, name: str = "my.toml") -> Path:
        path = tmp_path / name
        path.write_text(text)
        return path

    return write


@pytest.fixture(autouse=True)
def precision_is_restored():
    before = jax.config.jax_enable_x64  # type: ignore[attr-defined]
    yield
    jax.config.update("jax_enable_x64", before)


def call(*argv: object) -> tuple[int, str, str]:
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main([str(argument) for argument in argv])
    return code, out.getvalue(), err.getvalue()


def alone(body: str, spacing: float = 0.02, gravity: str = "[0.0, -9.81]") -> str:
    return f"""
[case]
spacing = {spacing}
gravity = {gravity}
[[fluid]]
density = 1000.0
[[fluid.body]]
{body}
"""


def places(case) -> set[tuple[float, ...]]:
    position = np.round(np.asarray(case.particles.position) / case.spacing, 4)
    return {tuple(row) for row in np.column_stack([position, case.particles.kind]).tolist()}


@pytest.mark.parametrize(
    ("body", "area"),
    [
        ("box = [[0.1, 0.2], [0.7, 0.62]]", 0.6 * 0.42),
        ("polygon = [[0.013, 0.0], [0.613, 0.0], [0.613, 0.4], [0.013, 0.4]]", 0.24),
        (f"polygon = {L_SHAPE}", 0.4 + 0.6 * 0.4),
        ("circle = { center = [0.3, 0.4], radius = 0.2 }", math.pi * 0.04),
        ("circle = { center = [0.307, 0.4], radius = 0.253 }", math.pi * 0.253**2),
        ("polygon = [[0.0, 0.0], [0.8, 0.1], [0.5, 0.7]]", 0.5 * (0.8 * 0.7 - 0.5 * 0.1)),
    ],
)
def test_a_body_has_the_mass_of_its_shape(file, body, area):
    case = read(file(alone(body))).case
    assert len(case.particles.kind) * 0.02**2 == pytest.approx(area, rel=0.01)
    near = KDTree(case.particles.position).query(case.particles.position, k=2)[0][:, 1]
    assert near == pytest.approx(0.02)


def test_a_sphere_has_the_mass_of_its_volume(file):
    text = alone("sphere = { center = [0.5, 0.5, 0.5], radius = 0.3 }", 0.05, "[0.0, 0.0, -9.81]")
    case = read(file(text)).case
    assert len(case.particles.kind) * 0.05**3 == pytest.approx(4.0 / 3.0 * math.pi * 0.3**3, rel=0.01)


@pytest.mark.parametrize(
    "wall",
    [
        'polygon = [[0.0, 0.0], [0.4, 0.0], [0.4, 0.6], [0.0, 0.6]]\nside = "outside"\nopen = ["+y"]',
        'polyline = [[0.0, 0.6], [0.0, 0.0], [0.4, 0.0], [0.4, 0.6]]\nside = "right"',
        'polyline = [[0.4, 0.6], [0.4, 0.0], [0.0, 0.0], [0.0, 0.6]]\nside = "left"\nthickness = 0.15',
    ],
)
def test_a_drawn_tank_has_the_particles_of_the_built_in_one(file, wall):
    setup = read(file(TANK.format(body="polygon = [[0.0, 0.0], [0.4, 0.0], [0.4, 0.4], [0.0, 0.4]]", wall=wall)))
    builtin = cases.hydrostatic(spacing=0.05)
    assert places(setup.case) == places(builtin)
    assert not casefile.check(setup).warnings


def test_water_in_a_drawn_tank_has_the_hydrostatic_pressure_of_the_built_in_one(file):
    wall = 'polygon = [[0.0, 0.0], [0.4, 0.0], [0.4, 0.6], [0.0, 0.6]]\nside = "outside"\nopen = ["+y"]'
    setup = read(file(TANK.format(body="box = [[0.0, 0.0], [0.4, 0.4]]", wall=wall)))
    bottom, builtin = [], cases.hydrostatic(spacing=0.05)
    # In the same domain, of which a program is compiled for each: ours has more room above the water.
    for case in (dataclasses.replace(setup.case, box=builtin.box), builtin):
        run = simulate(case, schemes.mps(), until=0.12, save_every=0.01, dt=0.002, progress=False)
        lowest = run.fluid[0] & (run.position[0, :, 1] < 0.03)
        bottom.append(run.pressure[:, lowest].mean(axis=1))
    assert bottom[0][:4] == pytest.approx(bottom[1][:4], rel=1e-3, abs=1.0)
    # Over time the source settles to the weight of the water, which is 2 to 3 % too light in this method.
    for pressure in bottom:
        assert pressure[-6:].mean() == pytest.approx(1000.0 * 9.81 * 0.375, rel=0.08)


def test_walls_keep_their_layers_around_corners_and_obstacles():
    case = read(EXAMPLE).case
    position, kind = np.asarray(case.particles.position) / case.spacing, np.asarray(case.particles.kind)
    first = position[kind == Kind.WALL]
    # Half a spacing behind the faces of the tank, and inside the obstacle on its floor.
    floor = first[np.isclose(first[:, 1], -0.5)]
    assert floor[:, 0].min() == pytest.approx(-0.5) and floor[:, 0].max() == pytest.approx(60.5)
    on_top = first[np.isclose(first[:, 1], 5.5) & (first[:, 0] > 39) & (first[:, 0] < 46)]
    assert np.sort(on_top[:, 0]) == pytest.approx([40.5, 41.5, 42.5, 43.5, 44.5])
    assert not np.any((floor[:, 0] > 41) & (floor[:, 0] < 44))
    near = KDTree(position).query(position, k=2)[0][:, 1]
    assert near.min() > 0.7 - 1e-9


def test_a_wall_two_sides_of_which_meet_has_no_hole(file):
    # Five spacings wide: two layers from each side leave room for one row in the middle.
    text = alone("box = [[0.0, 0.0], [0.1, 0.1]]", 0.02) + '[[wall]]\nbox = [[0.3, 0.0], [0.4, 0.4]]\nside = "inside"\n'
    case = read(file(text)).case
    wall = np.asarray(case.particles.position)[np.asarray(case.particles.kind) != Kind.FLUID]
    x, y = np.meshgrid(np.linspace(0.31, 0.39, 20), np.linspace(0.02, 0.38, 60))
    assert KDTree(wall).query(np.stack([x.ravel(), y.ravel()], axis=1))[0].max() < 0.85 * 0.02


def test_fluid_drawn_over_an_obstacle_keeps_clear_of_it(file):
    wall = 'circle = { center = [0.5, 0.5], radius = 0.2 }\nside = "inside"'
    case = read(file(TANK.format(body="box = [[0.0, 0.0], [1.0, 1.0]]", wall=wall))).case
    fluid = np.asarray(case.particles.fluid)
    position = np.asarray(case.particles.position)
    assert np.linalg.norm(position[fluid] - 0.5, axis=1).min() > 0.2 - 0.25 * 0.05
    assert KDTree(position[~fluid]).query(position[fluid])[0].min() >= 0.7 * 0.05 * (1 - 1e-6)
    assert fluid.sum() * 0.05**2 == pytest.approx(1.0 - math.pi * 0.04, rel=0.01)


def test_fluid_drawn_over_the_walls_of_its_tank_fills_the_tank(file, tmp_path):
    tank = 'circle = { center = [0.5, 0.5], radius = 0.4 }\nside = "outside"'
    case = read(file(TANK.format(body="box = [[-1.0, -1.0], [2.0, 0.5]]", wall=tank).replace("0.05", "0.02"))).case
    fluid, position = np.asarray(case.particles.fluid), np.asarray(case.particles.position)
    assert np.linalg.norm(position[fluid] - 0.5, axis=1).max() < 0.4
    assert fluid.sum() * 0.02**2 == pytest.approx(0.5 * math.pi * 0.16, rel=0.02)
    trimesh.creation.icosphere(subdivisions=4, radius=0.4).export(tmp_path / "ball.stl")
    text = alone("box = [[-1.0, -1.0, -1.0], [1.0, 1.0, 0.0]]", 0.04, "[0.0, 0.0, -9.81]")
    case = read(file(text + '[[wall]]\nstl = "ball.stl"\nside = "outside"\n')).case
    fluid, position = np.asarray(case.particles.fluid), np.asarray(case.particles.position)
    assert np.linalg.norm(position[fluid], axis=1).max() < 0.4 <= np.linalg.norm(position[~fluid], axis=1).min() + 0.002
    assert fluid.sum() * 0.04**3 == pytest.approx(2.0 / 3.0 * math.pi * 0.064, rel=0.02)


def test_a_later_body_takes_the_place_of_an_earlier_one(file):
    text = alone("box = [[0.0, 0.0], [1.0, 1.0]]", 0.05)
    text += "[[fluid]]\ndensity = 2000.0\n[[fluid.body]]\nbox = [[0.2, 0.2], [0.4, 0.5]]\nvelocity = [1.0, 2.0]\n"
    text += "rotation = 3.0\ncenter = [0.3, 0.3]\n"
    case = read(file(text)).case
    phase, position = np.asarray(case.particles.phase), np.asarray(case.particles.position)
    assert (np.bincount(phase) == [400 - 24, 24]).all()
    assert case.fluids.density.tolist() == [1000.0, 2000.0]
    x, y = (position[phase == 1] - 0.3).T
    expected = np.stack([1.0 - 3.0 * y, 2.0 + 3.0 * x], axis=1)
    assert np.asarray(case.particles.velocity)[phase == 1] == pytest.approx(expected)
    assert not np.any(case.particles.velocity[phase == 0])


@pytest.mark.parametrize(
    "scheme",
    [pytest.param(name, marks=pytest.mark.slow if name != "mps_cd_gc_ds" else ()) for name in scheme_factories()],
)
def test_the_l_shaped_tank_runs_with_every_scheme(scheme):
    setup = CaseFile(EXAMPLE).build(scheme, spacing=0.04)
    run = simulate(setup.case, setup.scheme, until=0.01, dt=0.001, progress=False)
    assert run.status.completed and run.summary["steps"] == 10
    assert run.fluid[-1].sum() == 200
    # The column falls freely but where the floor holds it: less than g t, and not upward.
    assert -9.81 * 0.011 < run.velocity[-1][run.fluid[-1]][:, 1].mean() < 0.0


@pytest.mark.slow
def test_a_tank_from_an_stl_file_holds_water_in_three_dimensions(file, tmp_path):
    trimesh.creation.box(bounds=[[0.0, 0.0, 0.0], [400.0, 200.0, 500.0]]).export(tmp_path / "tank.stl")
    text = alone("box = [[0.0, 0.0, 0.0], [0.4, 0.2, 0.3]]", 0.1, "[0.0, 0.0, -9.81]")
    text += '[[wall]]\nstl = "tank.stl"\nscale = 0.001\nside = "outside"\nopen = ["+z"]\n'
    setup = read(file(text))
    position, kind = np.asarray(setup.case.particles.position), np.asarray(setup.case.particles.kind)
    assert np.sum(kind == Kind.FLUID) == 4 * 2 * 3
    # Floor, two sides and two ends with their edges, five rows high.
    assert np.sum(kind == Kind.WALL) == 6 * 4 * 6 - 4 * 2 * 5
    assert position[:, 2].max() < 0.5 and position[:, 2].min() == pytest.approx(-0.25)
    assert KDTree(position).query(position, k=2)[0][:, 1] == pytest.approx(0.1)
    run = simulate(setup.case, by_diagonal(setup.scheme), until=0.15, save_every=0.015, dt=0.003, progress=False)
    assert run.status.completed
    bottom = run.fluid[0] & (run.position[0, :, 2] < 0.06)
    assert run.pressure[-5:, bottom].mean() == pytest.approx(1000.0 * 9.81 * 0.25, rel=0.1)


@pytest.mark.parametrize("name", case_factories())
def test_the_template_of_a_built_in_case_makes_the_same_particles(file, name):
    made, expected = read(file(template(name))).case, case_factories()[name]()
    assert made.name == expected.name == name
    for ours, theirs in zip(jax.tree.leaves(made.undescribed()), jax.tree.leaves(expected.undescribed()), strict=True):
        assert np.array_equal(ours, theirs)
    assert (made.box, made.spacing) == (expected.box, expected.spacing)


def test_arguments_of_built_in_cases_and_schemes_are_taken_from_the_file(file):
    path = file(
        '[case]\nbuiltin = "dam_break"\nspacing = 0.1\nwidth = 0.4\n'
        '[scheme]\nname = "mps"\nrelaxation = 0.1\ntime_step.courant = 0.05\nalpha = 0.03\ndrift_free = true\n'
    )
    setup = read(path)
    assert dict(setup.case.parameters)["width"] == 0.4
    assert float(setup.scheme.source.relaxation) == pytest.approx(0.1)  # type: ignore[attr-defined]
    assert float(setup.scheme.time_step.courant) == pytest.approx(0.05)
    assert setup.scheme.name == "stochastic mps"
    other = CaseFile(path).build("mps_hs_gc_ds", 0.05, ["width=0.3", "beta=0.9"], {"until": 3.0})
    assert (other.scheme.name, other.case.spacing, other.times["until"]) == ("stochastic mps_hs_gc_ds", 0.05, 3.0)
    assert dict(other.case.parameters)["width"] == 0.3


BODY, WALL = "box = [[0.0, 0.0], [0.4, 0.4]]", 'box = [[0.0, 0.0], [0.4, 0.6]]\nside = "outside"'
GOOD = TANK.format(body=BODY, wall=WALL)
FAULTS = [
    (GOOD.replace("spacing = 0.05", 'spacing = "wide"'), "[case]: spacing must be a valid number, got 'wide'"),
    (GOOD.replace("spacing = 0.05", "spacing = true"), "[case]: spacing must be a valid number, got True"),
    (GOOD.replace("spacing = 0.05", "spacing = -1"), "[case]: spacing must be greater than 0, got -1"),
    (GOOD.replace("spacing = 0.05", "spacing = nan"), "[case]: spacing must be a finite number, got nan"),
    (GOOD.replace("spacing = 0.05\n", ""), "[case]: spacing is missing"),
    (GOOD.replace("spacing", "sapcing"), "[case]: sapcing is not known (did you mean spacing?)"),
    (GOOD.replace("density = 1000.0", "density = -1.0"), "[[fluid]] 1: density must be greater than 0, got -1.0"),
    (GOOD.replace("box = [[0.0, 0.0], [0.4, 0.4]]", "bx = 3"), "[[fluid.body]] 1: bx is not known (did you mean box?)"),
    (GOOD.replace('side = "outside"', 'sides = "x"'), "[[wall]] 1: sides is not known (did you mean side?)"),
    (GOOD.replace('"outside"', '"left"'), "[[wall]] 1: side must be outside or inside for a box, got left"),
    (GOOD + "[[wal]]\nbox = 3\n", "wal is not known (did you mean wall?)"),
    (GOOD + "layers = 0\n", "[[wall]] 1: layers must be greater than or equal to 1, got 0"),
    (GOOD + "layers = 2\nthickness = 0.1\n", "[[wall]] 1: must have layers or thickness, got both: 2 and 0.1 m"),
    (GOOD + 'open = ["up"]\n', "[[wall]] 1: open[0] must be '-x', '+x'"),
    (GOOD + 'open = ["+z"]\n', "[[wall]] 1: open must be among the sides of 2-D, got +z"),
    (
        GOOD.replace(BODY, "polygon = [[0, 0], [0.4, 0.4], [0.4, 0.0], [0.0, 0.4]]"),
        "[[fluid]] 1, [[fluid.body]] 1: polygon must not cross itself or touch itself, got Self-intersection[0.2 0.2]",
    ),
    (GOOD.replace(BODY, "box = [[0.0, 0.0], [0.4, 0.0]]"), "[[fluid.body]] 1: box must have an area"),
    (GOOD.replace(BODY, "box = [[0.0, 0.0, 0.0], [0.4, 0.1, 0.1]]"), "box must have 2 components, as gravity has"),
    (GOOD.replace(BODY, BODY + "\ncircle = {center = [0.0, 0.0], radius = 1.0}"), "exactly one of polygon, box"),
    (GOOD.replace(BODY, BODY + "\nrotation = [0.0, 0.0, 1.0]"), "rotation must be a number [rad/s] in 2-D"),
    (GOOD.replace(BODY, "stl = 'a.stl'"), "[[fluid.body]] 1: stl must be one of polygon, box, circle in 2-D"),
    (
        GOOD.replace("[[fluid]]", "lower = [0.1, -0.2]\nupper = [1.0, 1.0]\n[[fluid]]", 1),
        "[[fluid]] 1, [[fluid.body]] 1: particles must lie in the box from (0.1, -0.2) m",
    ),
    (GOOD + '[[probe]]\nkind = "presure"\npoint = [0.0, 0.0]\n', "[[probe]] 1: "),
    (GOOD + '[[probe]]\nkind = "pressure"\npiont = [0.0, 0.0]\n', "piont is not known (did you mean point?)"),
    (GOOD + '[[probe]]\nkind = "wave_gauge"\nx = 0.0\ny = 0.1\n', "[[probe]] 1: y must be given in 3-D"),
    (
        GOOD + "[scheme]\nbeat = 0.9\n",
        "[scheme]: keys must name an argument of mps, or a value of the scheme, got beat",
    ),
    (GOOD + "[scheme]\nbeta = 9.0\n", "[scheme]: beta must be between 0 and 1, got 9"),
    (GOOD + "[scheme]\nbeta = '0.9'\n", "[scheme]: beta must be a number, true or false, or a list of numbers"),
    (GOOD + "[scheme]\nname = 'msp'\n", "[scheme]: name must be one of cmps_hs"),
    (GOOD + "[run]\nuntil = 0.0\n", "[run]: until must be greater than 0, got 0.0"),
    (GOOD + "[run]\nprecision = 'half'\n", "[run]: precision must be 'single' or 'double', got 'half'"),
    ("[case]\nbuiltin = 'dam_brake'\n", "[case]: builtin must be one of dam_break"),
    ("[case]\nbuiltin = 'dam_break'\nwidht = 0.2\n", "[case]: widht is not known (did you mean width?)"),
    ("[case]\nbuiltin = 'dam_break'\nwidth = '0.2'\n", "[case]: width must be a valid number, got '0.2'"),
    ("[case]\nbuiltin = 'dam_break'\nwidth = 5.0\n", "[case]: width must be at most tank_length (2 m), got 5 m"),
    ("[case]\nbuiltin = 'standing_wave'\nfloor = 'mud'\n", "[case]: floor must be 'wall' or 'mirror', got 'mud'"),
    ("spacing = ", "must be TOML: "),
]


@pytest.mark.parametrize(("text", "words"), FAULTS, ids=[words[:50] for _, words in FAULTS])
def test_a_fault_is_told_in_one_line_with_file_table_key_and_rule(file, text, words):
    path = file(text)
    with pytest.raises(CaseFileError) as caught:
        read(path)
    assert all(line.startswith(f"{path}: ") and "\n" not in line for line in caught.value.faults)
    assert any(words in line for line in caught.value.faults)


def test_faults_are_told_together_and_by_the_command_line(file, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = file(GOOD.replace("spacing = 0.05", "spacing = -1").replace("density", "desnity"))
    code, out, err = call("run", path)
    assert (code, out) == (2, "")
    assert len(err.splitlines()) == 3 and all(line.startswith(f"error: {path}: ") for line in err.splitlines())
    assert "spacing must be" in err and "did you mean density?" in err and "density is missing" in err
    assert [p.name for p in tmp_path.iterdir()] == ["my.toml"]
    assert call("check", "nowhere.toml")[2] == "error: nowhere.toml: the file must exist\n"


def test_a_mesh_that_is_missing_or_has_a_hole_is_told(file, tmp_path):
    mesh = trimesh.creation.box(extents=[1.0, 1.0, 1.0])
    mesh.update_faces(np.arange(len(mesh.faces)) > 0)
    mesh.export(tmp_path / "open.stl")
    (tmp_path / "text.stl").write_text("not a mesh")
    for name, words in (
        ("open", "must be watertight"),
        ("none", "must be a file that exists"),
        ("text", "must be an STL file"),
    ):
        with pytest.raises(CaseFileError, match=words) as caught:
            read(file(alone(f'stl = "{name}.stl"', 0.05, "[0.0, 0.0, -9.81]")))
        assert f"[[fluid]] 1, [[fluid.body]] 1: stl {words}" in caught.value.faults[0]


def test_check_counts_estimates_and_draws_and_warns(file, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, out, err = call("check", EXAMPLE, "--spacing", 0.04)
    assert (code, err) == (0, "")
    for text in ("200 particles, 1000 kg/m^3, 320 kg per m", "time step", "memory", "wall time", "l_shaped_tank.png"):
        assert text in out
    assert (tmp_path / "l_shaped_tank.png").stat().st_size > 0
    behind = """[[fluid]]
density = 900.0
[[fluid.body]]
box = [[-0.3, 0.0], [-0.15, 0.22]]
[[probe]]
name = "far"
kind = "pressure"
point = [9.0, 9.0]
"""
    _, _, err = call("check", file(GOOD + behind))
    assert "touch a wall from behind" in err and "body 2 has the mass of its shape to -9.1 % only" in err
    assert "far lies outside" in err
    good = read(file(GOOD))
    assert not casefile.check(good).warnings
    position = good.case.particles.position
    for to, words in (([0.075, 0.045], "one another, first at (0."), ([0.0, 0.025], "a wall, first at (0, 0.025)")):
        moved = eqx.tree_at(lambda c: c.particles.position, good.case, position.at[0].set(jax.numpy.array(to)))
        warnings = casefile.check(dataclasses.replace(good, case=moved)).warnings
        assert any(f"nearer than 0.7 spacings to {words}" in line for line in warnings)


def test_the_estimate_of_steps_goes_from_rest_to_the_speed_of_a_fall(file):
    setup = read(file("[case]\nbuiltin = 'dam_break'\nspacing = 0.1\n[run]\nuntil = 0.6\n"))
    # 0.044 √(l0 / g) at rest; 0.2 l0 / u after a fall by 1.2 m, from the highest particle to the lowest dummy.
    slow, fast = 0.044 * math.sqrt(0.1 / 9.81), 0.2 * 0.1 / math.sqrt(2.0 * 9.81 * 1.2)
    assert casefile.check(setup).expected["steps"] == f"{math.ceil(0.6 / slow)} to {math.ceil(0.6 / fast)}"
    rest = read(file("[case]\nbuiltin = 'square_patch'\nspacing = 0.1\n[run]\nuntil = 1.0\ndt = 0.01\n"))
    assert casefile.check(rest).expected["steps"] == "100 to 100"


def test_a_new_file_runs_from_the_command_line_and_writes_its_probes(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, text, _ = call("new")
    assert code == 0 and tomllib.loads(text)["case"]["name"] == "l_shaped_tank"
    assert text == EXAMPLE.read_text() == template("tank")
    Path("mine.toml").write_text(text)
    options = ("--spacing", 0.04, "--until", 0.02, "--save-every", 0.01, "--dt", 0.001, "--set", "relaxation=0.1")
    code, out, err = call("run", "mine.toml", *options)
    assert (code, err) == (0, "") and "probes.csv" in out
    with Path("mine/probes.csv").open() as file:
        head, *rows = csv.reader(file)
    assert head == ["time [s]", "floor [Pa]", "right wall [Pa]", "gauge [m]", "front [m]"]
    table = np.array(rows, float)
    assert table[:, 0] == pytest.approx([0.0, 0.01, 0.02])
    # The dry wall and the dry gauge, the floor under the column, and its edge.
    assert not table[:, 2].any() and np.isnan(table[:, 3]).all()
    assert 0.1 * 7800.0 < table[-1, 1] < 7800.0
    assert table[0, 4] == pytest.approx(0.4) and table[-1, 4] >= 0.4
    assert call("run", "mine.toml", *options)[0] == 2
    assert call("new", "dam_brake")[0] == 2
