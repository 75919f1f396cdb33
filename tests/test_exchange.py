"""Particles for other programs and from them."""

import dataclasses
import re
from pathlib import Path

import jax
import numpy as np
import pytest
from test_plotting import make_run

import jaxmps as mps
from jaxmps.command_line import main
from jaxmps.results import Run

FORMATS = ("csv", "prof", "vtu", "vtp")


def awkward(dim: int = 2) -> Run:
    """A run with numbers that need all their digits, and a particle of each kind."""
    run, rng = make_run(dim), np.random.default_rng(3)
    kind = run.kind.copy()
    kind[:, 7] = mps.Kind.REMOVED
    changed = {name: getattr(run, name) * (1.0 + rng.random(getattr(run, name).shape) / 3.0) for name in NUMBERS}
    changed["velocity"][0, 0], changed["pressure"][:, 3] = -0.0, 5e-324
    return dataclasses.replace(run, **changed, kind=kind)


NUMBERS = ("position", "velocity", "pressure", "number_density")


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("form", FORMATS)
def test_every_format_gives_back_the_particles_bit_for_bit(tmp_path, form, dim):
    run = awkward(dim)
    path = mps.io.export(run, tmp_path / f"frame.{form}", 1)
    particles = mps.io.particles_from(path)
    for name in ("position", "velocity", "pressure"):
        found = np.asarray(getattr(particles, name))
        assert found.dtype == np.float64
        assert found.tobytes() == np.ascontiguousarray(getattr(run, name)[1]).tobytes(), name
    np.testing.assert_array_equal(particles.kind, run.kind[1])
    np.testing.assert_array_equal(particles.phase, run.phase)


@pytest.mark.parametrize("form", ["csv", "vtp", "vtu"])
def test_phases_come_back_from_the_formats_that_have_them(tmp_path, form):
    run = dataclasses.replace(awkward(), phase=np.arange(len(awkward().phase)) % 3)
    particles = mps.io.particles_from(mps.io.export(run, tmp_path / f"frame.{form}"))
    np.testing.assert_array_equal(particles.phase, run.phase)


def test_a_prof_is_what_the_textbooks_read(tmp_path):
    run = awkward()
    lines = mps.io.export(run, tmp_path / "frame.prof", 2).read_text().splitlines()
    assert float(lines[0]) == run.time[2] and int(lines[1]) == run.kind.shape[1] == len(lines) - 2
    table = np.array([line.split() for line in lines[2:]], float)
    np.testing.assert_array_equal(table[:, 0], np.array([0, 2, 3, -1])[run.kind[2]])
    np.testing.assert_array_equal(table[:, [1, 2]], run.position[2])
    np.testing.assert_array_equal(table[:, [4, 5]], run.velocity[2])
    np.testing.assert_array_equal(table[:, 7:].T, [run.pressure[2], run.number_density[2]])
    assert not table[:, [3, 6]].any()


def test_types_of_a_prof_are_what_the_user_says(tmp_path):
    run = awkward()
    run = dataclasses.replace(run, phase=np.where((run.kind[-1] == 0) & (np.arange(len(run.phase)) > 20), 1, 0))
    path = tmp_path / "frame.prof"
    with pytest.raises(ValueError, match=r"types must have .* fluid of phase 1, got 0 \(fluid\), 2 \(wall\)"):
        mps.io.export(run, path)
    types = {0: mps.Kind.FLUID, 1: (mps.Kind.FLUID, 1), 5: mps.Kind.WALL, 6: mps.Kind.DUMMY, -1: mps.Kind.REMOVED}
    particles = mps.io.particles_from(mps.io.export(run, path, types=types), types=types)
    np.testing.assert_array_equal(particles.phase, run.phase)
    np.testing.assert_array_equal(particles.kind, run.kind[-1])
    with pytest.raises(ValueError, match=r"type must be one of 0 \(fluid\), .* got 1"):
        mps.io.particles_from(path)


def test_a_prof_may_be_without_number_density_and_pressure(tmp_path):
    for line, pressure in (("0 1 2 0 3 4 0", 0.0), ("0 1 2 0 3 4 0 98.5", 98.5)):
        (tmp_path / "a.prof").write_text(f"0.5\n2\n{line}\n{line}\n")
        particles = mps.io.particles_from(tmp_path / "a.prof")
        np.testing.assert_array_equal(particles.velocity, [[3.0, 4.0]] * 2)
        np.testing.assert_array_equal(particles.pressure, [pressure] * 2)


def test_a_csv_has_its_units_and_time_and_needs_no_more_than_places(tmp_path):
    header, first, *_ = mps.io.export(awkward(), tmp_path / "a.csv").read_text().splitlines()
    assert header.startswith("kind,phase,x [m],y [m],u [m/s],v [m/s],pressure [Pa],") and header.endswith("time [s]")
    assert float(first.split(",")[-1]) == pytest.approx(0.15)
    path = tmp_path / "places.csv"
    path.write_text("x,y\n0.1,0.2\n\n0.3,0.4\n")
    particles = mps.io.particles_from(path)
    np.testing.assert_array_equal(particles.position, [[0.1, 0.2], [0.3, 0.4]])
    assert not np.any(particles.velocity) and not np.any(particles.pressure) and particles.fluid.all()


def test_places_from_elsewhere_start_a_run(tmp_path):
    case = mps.cases.dam_break(spacing=0.1)
    path = tmp_path / "start.csv"
    points, kind = np.asarray(case.particles.position), np.asarray(case.particles.kind)
    path.write_text(
        "x,y,kind\n" + "".join(f"{x!r},{y!r},{k}\n" for (x, y), k in zip(points.tolist(), kind, strict=True))
    )
    own = mps.Case(mps.io.particles_from(path), case.fluids, case.gravity, case.spacing, case.box)
    ours, theirs = (mps.simulate(c, mps.schemes.mps(), until=0.02) for c in (case, own))
    np.testing.assert_array_equal(ours.position, theirs.position)


def test_two_dimensions_are_told_from_three_by_the_third_component_or_by_the_user(tmp_path):
    flat = mps.io.export(awkward(2), tmp_path / "flat.prof")
    assert mps.io.particles_from(flat).position.shape[1] == 2
    assert mps.io.particles_from(flat, dim=3).position.shape[1] == 3
    solid = mps.io.export(awkward(3), tmp_path / "solid.vtp")
    with pytest.raises(ValueError, match=r"solid.vtp must have no third components for dim = 2"):
        mps.io.particles_from(solid, dim=2)


@pytest.mark.parametrize(
    ("name", "text", "fault"),
    [
        ("a.prof", "0.5\n2\n0 1 1 0 0 0 0 0 6.5\n0 1 2 0 0 0\n", "line 4: there must be 9 numbers, got 6"),
        ("a.prof", "0.5\n3\n0 1 1 0 0 0 0 0 6.5\n", "must have 3 lines of particles, as line 2 says, got 1"),
        ("a.prof", "0.5\n1\n0 1 nan 0 0 0 0 0 6.5\n", "line 3: numbers must be finite, got 0 1 nan"),
        ("a.prof", "0.5\n1\n7 1 1 0 0 0 0 0 6.5\n", "particle 0: type must be one of 0 (fluid), 2 (wall)"),
        ("a.prof", "0.5\n1\n0.5 1 1 0 0 0 0 0 6.5\n", "particle 0: type must be one of"),
        ("a.prof", "0 1 1 0 0 0 0 0 6.5\n", "must begin with lines of the time [s] and the number of particles"),
        ("a.prof", "", "must begin with lines of the time"),
        ("a.prof", "0.5\n0\n", "must have at least one particle, got none"),
        ("a.csv", "x,y\n1,2\n3\n", "line 3: there must be 2 numbers, got 1"),
        ("a.csv", "x,y\n1,2\n\n3,left\n", "line 4: there must be 2 numbers, got 3,left"),
        ("a.csv", "x,y\n1,inf\n", "line 2: numbers must be finite, got 1,inf"),
        ("a.csv", "x,y,kind\n1,2,9\n", "particle 0: kind must be one of 0 (fluid), 1 (wall), 2 (dummy)"),
        ("a.csv", "x,y,phase\n1,2,0.5\n", "particle 0: phase must be a whole number of 0 or more, got 0.5"),
        ("a.csv", "x,colour\n1,2\n", "line 1: columns must be x, y and others of"),
        ("a.csv", "x,y,u\n1,2,3\n", "line 1: columns must have all or none of u, v"),
        ("a.csv", "x,y\n", "must have at least one particle, got none"),
        ("a.csv", "", "line 1: columns must be x, y"),
        ("a.vtu", "<VTKFile", "must be a VTK file of particles, got one that cannot be read"),
        ("a.txt", "", "path must end in one of .csv, .prof, .vtu, .vtp, got a.txt"),
    ],
)
def test_what_is_wrong_with_a_file_is_told_in_one_line(tmp_path, name, text, fault):
    (tmp_path / name).write_text(text)
    with pytest.raises(ValueError, match=re.escape(fault)) as told:
        mps.io.particles_from(tmp_path / name)
    assert "\n" not in str(told.value) and name in str(told.value)


def test_values_in_a_vtk_file_are_checked_as_well(tmp_path):
    run = awkward()
    run.pressure[-1, 5] = np.nan
    with pytest.raises(ValueError, match=r"a.vtp, particle 5: pressure must be finite, got nan"):
        mps.io.particles_from(mps.io.export(run, tmp_path / "a.vtp"))


def test_an_existing_file_and_a_frame_that_is_not_there_are_refused(tmp_path):
    path = mps.io.export(awkward(), tmp_path / "a.csv")
    before = path.read_bytes()
    with pytest.raises(FileExistsError, match=r"a.csv exists already"):
        mps.io.export(awkward(), path, 0)
    assert path.read_bytes() == before
    mps.io.export(awkward(), path, 0, overwrite=True)
    assert path.read_bytes() != before
    with pytest.raises(IndexError, match="frame must be between -4 and 3, got 4"):
        mps.io.export(awkward(), tmp_path / "b.csv", 4)
    with pytest.raises(FileNotFoundError, match="there is no file"):
        mps.io.particles_from(tmp_path / "none.csv")


@pytest.fixture
def file(tmp_path: Path, monkeypatch) -> str:
    """The file of a run in the current directory."""
    run = awkward()
    monkeypatch.chdir(tmp_path)
    writer = mps.io.Writer(
        "run.vtkhdf", phase=run.phase, density=run.density, spacing=0.1, dim=2, dtype="f8", metadata=run.metadata
    )
    for k in range(len(run)):
        writer.append(**{name: getattr(run, name)[k] for name in (*NUMBERS, "surface", "kind", "energy", "time")})
    return "run.vtkhdf"


def test_the_command_exports_a_frame_or_all_and_replaces_nothing_unasked(file, capsys):
    assert main(["export", file, "--to", "csv"]) == 0
    assert capsys.readouterr().out.strip() == "run_0003.csv"
    assert main(["export", file, "--to", "prof", "--frame", "all", "--out", "new/all.prof"]) == 0
    assert [path.name for path in sorted(Path("new").iterdir())] == [f"all_{k:04d}.prof" for k in range(4)]
    np.testing.assert_array_equal(mps.io.particles_from("new/all_0001.prof").position, awkward().position[1])
    types = "0=fluid,1=wall,2=dummy,-1=removed"
    assert main(["export", file, "--to", "prof", "--frame", "1", "--out", "x.prof", "--types", types]) == 0
    assert {line.split()[0] for line in Path("x.prof").read_text().splitlines()[2:]} == {"0", "1", "2", "-1"}
    capsys.readouterr()
    for line, words in {
        "--to csv": "run_0003.csv exists --force",
        "--to xyz": "to csv prof xyz",
        "--to csv --frame 4": "frame between 3 4",
        "--to csv --frame half": "frame whole all half",
        "--to csv --out a.prof": "out .csv a.prof",
        "--to prof --types 0=water --out a.prof": "--types fluid wall dummy 0=water",
        "--to prof --types 0=fluid --out a.prof": "types number wall",
    }.items():
        assert main(["export", file, *line.split()]) == 2
        error = capsys.readouterr().err
        assert error.count("\n") == 1 and not [word for word in words.split() if word not in error], error
    assert not Path("a.prof").exists()
    assert main(["export", file, "--to", "csv", "--force"]) == 0


def test_single_precision_comes_back_in_single_precision(tmp_path):
    run = awkward()
    run = dataclasses.replace(run, position=run.position.astype("f4"), velocity=run.velocity.astype("f4"))
    path = mps.io.export(run, tmp_path / "a.csv")
    with jax.enable_x64(False):
        np.testing.assert_array_equal(mps.io.particles_from(path).position, run.position[-1])


PARAVIEW = """"pressure","velocity:0","velocity:1","velocity:2","name","Points:0","Points:1","Points:2"
7.5,1,2,0,"a, wet",0.25,0.5,0
-1e3,3,4,0,dry,0.75,1.5,0
"""
NAMES = {"x": "Points:0", "y": "Points:1", "u": "velocity:0", "v": "velocity:1", "pressure": "pressure"}


def assert_two(particles: mps.Particles) -> None:
    np.testing.assert_array_equal(particles.position, [[0.25, 0.5], [0.75, 1.5]])
    np.testing.assert_array_equal(particles.velocity, [[1.0, 2.0], [3.0, 4.0]])
    np.testing.assert_array_equal(particles.pressure, [7.5, -1000.0])
    np.testing.assert_array_equal(particles.kind, 0)


def test_columns_of_a_csv_may_have_other_names_and_what_is_not_named_is_not_read(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(PARAVIEW)
    assert_two(mps.io.particles_from(path, columns=NAMES))
    solid = mps.io.particles_from(path, columns=NAMES | {"z": "Points:2", "w": "velocity:2"})
    np.testing.assert_array_equal(solid.position, [[0.25, 0.5, 0.0], [0.75, 1.5, 0.0]])


@pytest.mark.parametrize(
    ("separator", "decimal", "text"),
    [
        (";", ",", "x;y;u;v;pressure\n0,25;0,5;1;2,0;7,5\n0,75 ; 1,5; 3;4;-1e3\n"),
        ("\t", ".", "x [m]\ty [m]\tu\tv\tpressure\n0.25\t0.5\t1\t2\t7.5\n0.75\t1.5\t3\t4\t-1000\n"),
        ("\t", ",", "x\ty\tu\tv\tpressure\n0,25\t0,5\t1\t2\t7,5\n0,75\t1,5\t3\t4\t-1000\n"),
        (None, ".", "x  y u   v pressure\n 0.25 0.5\t1 2 7.5\n0.75 1.5 3 4  -1e3\n"),
        (";", ".", '"x";"y";"u";"v";"pressure"\n"0.25";"0.5";1;2;7.5\n0.75;1.5;3;4;-1e3\n'),
    ],
)
def test_separators_and_decimal_commas(tmp_path, separator, decimal, text):
    path = tmp_path / "a.csv"
    path.write_text(text)
    assert_two(mps.io.particles_from(path, separator=separator, decimal=decimal))


@pytest.mark.parametrize(
    ("given", "fault"),
    [
        ({"columns": {"x": "Points:0"}}, "columns must name x, y and others of kind, phase, x, y"),
        ({"columns": {"x": "Points:0", "y": "Points:1", "q": "b"}}, "columns must name x, y and others of"),
        (
            {"columns": {"x": "Points:0", "y": "Points:3"}},
            "line 1: columns must be Points:0, Points:3, each once, got",
        ),
        (
            {"columns": {"x": "Points:0", "y": "name"}},
            "line 2: there must be 8 values, with numbers in those that are read",
        ),
        ({"separator": ";;"}, "separator must be one character, or None for blanks, got ';;'"),
        ({"decimal": ","}, "decimal must be . or , and not the separator, got ','"),
        ({"decimal": "'"}, "decimal must be . or , and not the separator"),
    ],
)
def test_what_is_wrong_with_the_names_of_columns_is_told(tmp_path, given, fault):
    path = tmp_path / "a.csv"
    path.write_text(PARAVIEW)
    with pytest.raises(ValueError, match=re.escape(fault)) as told:
        mps.io.particles_from(path, **given)
    assert "\n" not in str(told.value)


def test_names_of_columns_are_for_a_csv_only(tmp_path):
    path = mps.io.export(awkward(), tmp_path / "a.prof")
    with pytest.raises(ValueError, match=r"columns, separator and decimal must be given for a .csv only, got a.prof"):
        mps.io.particles_from(path, columns=NAMES)
