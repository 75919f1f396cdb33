"""What ensembles observe, and their statistics, against closed forms."""

import dataclasses
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxmps as mps
from jaxmps import plotting
from jaxmps.command_line import main
from jaxmps.diagnostics import observation, volume_fraction
from jaxmps.io import read_ensemble, write_ensemble
from jaxmps.io.member_files import MemberFiles

SCHEME = mps.schemes.mps


def state(case: mps.Case) -> mps.State:
    return mps.start(case, SCHEME())


def test_water_in_a_tank_has_its_length_height_energy_and_is_wet_where_it_is():
    case = mps.cases.hydrostatic(spacing=0.05, length=0.6, height=0.4)
    seen = observation(case, state(case), gauges=(0.3,))
    assert float(seen["front"]) == pytest.approx(0.6)
    assert float(seen["top"]) == pytest.approx(0.4)
    assert float(seen["height"][0]) == pytest.approx(0.4)
    assert float(seen["potential"]) == pytest.approx(9.81 * 0.2) and float(seen["kinetic"]) == 0.0
    # Cells are at most two spacings long: as many are wet as the water is large, but for half a cell along its edges.
    shape = np.array(seen["wet"].shape)
    cell = np.prod(np.array(case.box.lengths) / shape)
    assert np.sum(seen["wet"]) * cell == pytest.approx(0.6 * 0.4, rel=0.25)


@pytest.mark.parametrize("dim", [2, 3])
def test_volume_is_kept_when_it_is_shared_out_among_cells(dim):
    case = mps.cases.dam_break(spacing=0.1, width=0.4, height=0.4) if dim == 2 else mps.cases.dam_break_3d(spacing=0.1)
    fraction = volume_fraction(case, state(case))
    cell = np.prod(np.array(case.box.lengths) / np.array(fraction.shape))
    fluid = int(np.sum(case.particles.fluid))
    assert float(fraction.sum()) * cell == pytest.approx(fluid * 0.1**dim)
    assert float(fraction.max()) < 1.6 and float(fraction.min()) == 0.0


def test_volume_that_crosses_the_seam_of_a_periodic_axis_is_kept():
    case = mps.cases.standing_wave(spacing=0.1, floor="mirror", amplitude=0.0, depth=0.3)
    moved = eqx.tree_at(
        lambda c: c.particles.position, case, case.box.wrap(case.particles.position + jnp.array([0.03, 0]))
    )
    fraction = volume_fraction(moved, state(moved))
    np.testing.assert_allclose(fraction.sum(axis=1), fraction.sum() / len(fraction), rtol=0.02)


def test_a_drop_that_flies_ahead_is_no_front():
    case = mps.cases.dam_break(spacing=0.05)
    drop = jnp.array([1.5, 0.9]) * case.box.upper[0] / 2.0
    flown = eqx.tree_at(lambda c: c.particles.position, case, case.particles.position.at[0].set(drop))
    assert case.particles.fluid[0]
    far, usual = observation(flown, state(flown)), observation(case, state(case))
    assert float(far["front"]) == pytest.approx(float(usual["front"]))


def synthetic(count: int = 5) -> mps.Ensemble:
    """Member k has the front k + t."""
    time, k = np.linspace(0.0, 1.0, 3), np.arange(count, dtype=float)
    front = k[:, None] + time
    series = {
        "front": front,
        "kinetic": 2.0 * front,
        "potential": -front,
        "wet": np.array([[[[k > 1] * 2] * 2] * 3 for k in range(count)]),
    }
    fine, alpha = mps.Outcome(), np.array([0.1, 0.1, 0.2, 0.2, 0.3], np.float32)
    return mps.Ensemble(
        time, np.arange(count), np.zeros((count, 2), np.uint32), {"noise.alpha": alpha},
        series, np.ones((count, 3), bool), (fine,) * count, {}, np.zeros(4, int), np.ones((count, 1)), 0.1,
        {"box": {"lower": [0, 0], "upper": [1, 2]}},
    )  # fmt: skip


def test_statistics_are_those_of_the_members_that_are_valid():
    many = synthetic()
    np.testing.assert_allclose(many.mean("front"), 2.0 + many.time)
    np.testing.assert_allclose(many.mean("energy"), 2.0 + many.time)
    np.testing.assert_allclose(many.variance("front"), 2.5)  # of 0, 1, 2, 3, 4, unbiased
    np.testing.assert_allclose(many.quantile("front", [0.0, 0.25, 1.0])[:, 0], [0.0, 1.0, 4.0])
    np.testing.assert_allclose(many.mean("wet"), 0.6)
    valid = many.valid.copy()
    valid[4, 2], valid[:4, 1] = False, False
    lost = dataclasses.replace(many, valid=valid)
    np.testing.assert_allclose(lost.mean("front"), [2.0, 4.5, 2.5])
    np.testing.assert_allclose(lost.variance("front"), [2.5, np.nan, 5.0 / 3.0])
    with pytest.raises(ValueError, match="name must be one of front, kinetic, potential, wet, got speed"):
        many.mean("speed")


def test_members_are_chosen_by_value_slice_and_mask_and_joined_again():
    many = synthetic()
    assert many.where("noise.alpha", 0.2).member.tolist() == [2, 3]
    assert many[many.of("front")[:, 0] > 2.5].member.tolist() == [3, 4] and len(many[:2]) == 2
    joined = mps.Ensemble.join([many[3:], many[[1]], many[[0, 2]]])
    np.testing.assert_array_equal(joined.of("front"), many.of("front"))
    assert joined.values["noise.alpha"].tolist() == many.values["noise.alpha"].tolist()
    with pytest.raises(ValueError, match=r"noise.alpha must be one of .*, got 0.25"):
        many.where("noise.alpha", 0.25)
    with pytest.raises(ValueError, match="frames must be kept"):
        many[0]


def test_bands_are_the_quantiles_and_the_map_is_the_probability():
    many = synthetic()
    axes: Any = plotting.bands(many, ("front",)).axes[0]
    (line,) = axes.lines
    np.testing.assert_allclose(line.get_ydata(), 2.0 + many.time)
    band = axes.collections[0].get_paths()[0].vertices
    assert band[:, 1].min() == pytest.approx(0.1) and band[:, 1].max() == pytest.approx(4.9)
    lines: Any = plotting.bands(many, ("front", "energy"), by="noise.alpha").axes[1].lines
    np.testing.assert_allclose([line.get_ydata()[0] for line in lines], [0.5, 2.5, 4.0])
    with pytest.raises(ValueError, match="names must be of series with one number at each frame, got wet"):
        plotting.bands(many, ("wet",))
    with pytest.raises(ValueError, match=r"by must be one of noise.alpha, got beta"):
        plotting.bands(many, by="beta")
    image = plotting.wet(many).axes[0].images[0]
    np.testing.assert_allclose(np.asarray(image.get_array()), 0.6)
    assert image.get_extent() == [0, 1, 0, 2]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--sweep", "alpha"], "sweep must have the form NAME=LOW:HIGH:COUNT or NAME=A,B,C, got 'alpha'"),
        (["--sweep", "alpha=0:1"], "sweep must have the form"),
        (["--sweep", "alpha=0:1:1"], "sweep must have the form"),
        (["--sweep", "alpa=0:1:2"], "did you mean alpha?"),
        (["--sweep", "alpha=0:2:3"], "alpha must be between 0 and 1, got 2"),
        (["--sweep", "ratio=2.1:3.1:2"], "in values alone, not in"),
        (["--members", "0"], "members must be a whole number of 1 or more, got 0"),
        (["--members", "20000"], "members must be at most 10000 in all, got 20000"),
        (["--jitter", "1"], "jitter must be between 0 and 0.3 spacings, got 1"),
        (["--hosts", "here"], "hosts must be auto, or ADDRESS:PORT with --processes and --process, got here"),
        (["--process", "0"], "hosts must be given with --processes and --process"),
        (["--hosts", "a:1", "--processes", "2", "--process", "2"], "process must be between 0 and 1, got 2"),
        (["--memory", "0"], "memory must be greater than zero, got 0 bytes"),
    ],
)  # fmt: skip
def test_wrong_options_of_an_ensemble_are_named_in_one_line(options, message, tmp_path, capsys):
    cache = jax.config.jax_compilation_cache_dir  # type: ignore[attr-defined]
    assert main(["ensemble", "standing_wave", "--spacing", "0.1", "--out", str(tmp_path / "here"), *options]) == 2
    told = capsys.readouterr().err
    assert told.startswith("error: ") and message in told and told.count("\n") == 1
    jax.config.update("jax_compilation_cache_dir", cache)


def test_a_folder_without_members_is_named(tmp_path, capsys):
    assert main(["gather", str(tmp_path)]) == 2
    assert "folder must be one that an ensemble was written to" in capsys.readouterr().err


@pytest.fixture
def folder(tmp_path) -> Path:
    """Three members, gathered."""
    written(tmp_path, 3)
    assert main(["gather", str(tmp_path)]) == 0
    return tmp_path


def written(folder: Path, count: int) -> None:
    files = MemberFiles(folder, {"case": {}, "members": list(range(count))}, overwrite=False)
    many = synthetic()
    for k in range(count):
        if k not in files:
            files.write(many[k : k + 1])


def kept(folder: Path) -> dict[str, tuple[int, bytes]]:
    return {path.name: (path.stat().st_mtime_ns, path.read_bytes()) for path in folder.iterdir()}


def test_members_that_are_gathered_already_are_told_so_in_one_line(folder, capsys):
    before = kept(folder)
    capsys.readouterr()
    assert main(["gather", str(folder)]) == 0
    told = capsys.readouterr()
    line = f"All 3 members in {folder} are in {folder / 'ensemble.h5'} already: there is nothing to gather.\n"
    assert (told.out, told.err) == (line, "") and kept(folder) == before
    assert main(["gather", str(folder), "--force"]) == 0
    assert "nothing" not in capsys.readouterr().out and kept(folder) != before


def test_members_that_came_later_are_gathered_and_it_is_told(folder, capsys):
    written(folder, 5)
    capsys.readouterr()
    assert main(["gather", str(folder)]) == 0
    out = capsys.readouterr().out
    assert out.startswith(
        f"{folder / 'ensemble.h5'} has 3 of the 5 members in {folder}: file and picture are made anew"
    )
    assert read_ensemble(folder / "ensemble.h5").member.tolist() == [0, 1, 2, 3, 4]
    assert main(["gather", str(folder)]) == 0 and "nothing to gather" in capsys.readouterr().out
    # One that was computed again.
    write_ensemble(folder / "member-000001.h5", synthetic()[1:2], overwrite=True)
    assert main(["gather", str(folder)]) == 0 and "has 4 of the 5 members" in capsys.readouterr().out
    # One that has to be.
    (folder / "member-000001.h5").unlink()
    assert main(["gather", str(folder)]) == 2 and "without 1 of them, the first 1" in capsys.readouterr().err


@pytest.mark.parametrize("change", ["another file", "more members", "other seeds", "other frames", "another case"])
def test_a_file_with_anything_else_is_not_replaced(folder, change, capsys):
    path, many = folder / "ensemble.h5", synthetic()
    others = {
        "more members": many,
        "other seeds": dataclasses.replace(many[:3], seed=many.seed[:3] + 1),
        "other frames": dataclasses.replace(many[:3], time=2.0 * many.time),
        "another case": dataclasses.replace(many[:3], metadata={}),
    }
    if change in others:
        write_ensemble(path, others[change], overwrite=True)
    else:
        path.write_text("not an ensemble")
    before = kept(folder)
    assert main(["gather", str(folder)]) == 2
    assert f"error: {path} exists already: choose another --out, or replace it with --force" in capsys.readouterr().err
    assert kept(folder) == before
