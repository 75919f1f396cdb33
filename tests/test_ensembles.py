"""Ensembles: members against single runs, batches, failures, files, statistics."""

import contextlib
import dataclasses
import functools
import io
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hasty import by_diagonal

import jaxmps as mps
from jaxmps.command_line import main
from jaxmps.ensembles import lanes
from jaxmps.ensembles.batch_size import bytes_of
from jaxmps.ensembles.members import members
from jaxmps.io import read_ensemble, write_ensemble
from jaxmps.running import empty_log, loop, starting

ALPHAS = (0.0, 0.02, 0.04)
KEYS = jax.vmap(jax.random.key)(jnp.arange(3))
TIMES: Any = {"until": 0.1, "save_every": 0.05}


def wave(k: int = 0) -> mps.Case:
    case = mps.cases.jitter(mps.cases.standing_wave(spacing=0.1, floor="mirror"), 0.01, jax.random.key(k))
    # Members that differ in their velocities, too, are compiled as those of which one is broken.
    return eqx.tree_at(lambda c: c.particles.velocity, case, jnp.full_like(case.particles.velocity, 1e-3 * k))


@functools.cache
def sweep():
    """Three members that differ in their start, in alpha and in their keys."""
    cases = [wave(k) for k in range(3)]
    schemes = [by_diagonal(mps.schemes.stochastic(mps.schemes.mps(), alpha=alpha)) for alpha in ALPHAS]
    return cases, schemes


@functools.cache
def all_of_them():
    return mps.ensemble(*sweep(), keys=KEYS, **TIMES)


@pytest.fixture
def swept():
    return sweep()


@pytest.fixture
def many():
    return all_of_them()


def test_members_by_themselves_are_single_runs_bit_for_bit(swept, many):
    for k, (case, scheme) in enumerate(zip(*swept, strict=True)):
        run = mps.simulate(case, scheme, key=KEYS[k], **TIMES)
        for name in ("time", "position", "velocity", "pressure", "energy", "kind"):
            np.testing.assert_array_equal(getattr(many[k], name), getattr(run, name))
    assert not np.array_equal(many.position[0], many.position[1])
    np.testing.assert_allclose(many.values["noise.alpha"], ALPHAS)
    assert set(many.values) == {"noise.alpha"}


def test_fixed_steps_are_those_of_single_runs_bit_for_bit_and_of_rollouts_to_round_off(swept):
    case, scheme = swept[0][2], swept[1][2]
    dt = 2.0**-9  # so that no frame time is rounded
    many = mps.ensemble(case, scheme, keys=KEYS[:2], until=8 * dt, dt=dt)
    run = mps.simulate(case, scheme, key=KEYS[1], until=8 * dt, dt=dt)
    np.testing.assert_array_equal(many.position[1], run.position)
    np.testing.assert_array_equal(many.pressure[1], run.pressure)
    end, _ = mps.rollout(case, scheme, mps.start(case, scheme), steps=8, dt=dt, key=KEYS[1])
    np.testing.assert_allclose(many.position[1, -1], end.particles.position, atol=1e-14)


@functools.cache
def in_one_program():
    return mps.ensemble(*sweep(), keys=KEYS, batch=3, **TIMES)


@pytest.mark.slow
def test_members_in_one_program_are_single_runs_to_round_off(many):
    together = in_one_program()
    # Round-off is amplified by some hundred steps of a chaotic flow.
    np.testing.assert_allclose(together.position, many.position, atol=1e-10)
    np.testing.assert_allclose(together.of("energy"), many.of("energy"), rtol=1e-10)
    assert together.valid.all() and all(outcome.completed for outcome in together.status)


@pytest.mark.parametrize("batch", [1, 3])
def test_a_member_that_blows_up_stays_as_it_was_and_disturbs_no_other(swept, batch):
    cases, schemes = swept
    sane = in_one_program() if batch == 3 else all_of_them()
    velocity = cases[1].particles.velocity.at[7].set(jnp.nan)
    broken = eqx.tree_at(lambda c: c.particles.velocity, cases[1], velocity)
    many = mps.ensemble([cases[0], broken, cases[2]], schemes, keys=KEYS, batch=batch, **TIMES)
    for k in (0, 2):
        np.testing.assert_array_equal(many.position[k], sane.position[k])
    assert [outcome.completed for outcome in many.status] == [True, False, True]
    (event,) = many.status[1].events
    assert event.status == mps.Status.NOT_FINITE and event.time == 0.0 and event.count == 1
    assert many.valid.tolist() == [[True] * 3, [True, False, False], [True] * 3]
    np.testing.assert_array_equal(many.position[1], np.stack([broken.particles.position] * 3))
    np.testing.assert_allclose(many.mean("top")[-1], sane.of("top")[[0, 2], -1].mean())
    assert len(many[1]) == 1


@pytest.mark.slow
def test_a_full_table_of_one_member_is_enlarged_without_changing_the_answer(swept, monkeypatch):
    batch = members(swept[0], swept[1], KEYS)
    usual = lanes.Lanes(batch, None, lambda case, state, log: state.particles.position, jax.devices()[:1])
    usual.reach(0.02)
    monkeypatch.setattr(starting, "usual_capacity", lambda reach, dim: 9)
    small = lanes.Lanes(batch, None, lambda case, state, log: state.particles.position, jax.devices()[:1])
    small.reach(0.02)
    np.testing.assert_allclose(small.look(), usual.look(), atol=1e-12)
    assert small._state.neighbors.capacity > 9


@pytest.mark.slow
def test_the_pressure_of_the_start_is_found_however_often_the_table_has_to_grow(swept, monkeypatch):
    batch = members(swept[0], swept[1], KEYS)
    pressures = []
    for capacity in (20, 3):  # 3 grows to 7 and to 11, and 12 neighbors are there
        monkeypatch.setattr(starting, "usual_capacity", lambda reach, dim, capacity=capacity: capacity)
        made = lanes.Lanes(batch, None, lambda case, state, log: state.particles.pressure, jax.devices()[:1])
        pressures.append(made.look(0.02))
    assert pressures[0].any()
    np.testing.assert_allclose(pressures[1], pressures[0], atol=1e-3 * pressures[0].max())


def test_memory_of_a_member_stays_below_what_is_reckoned_with(swept):
    case, scheme = swept[0][0], mps.schemes.stochastic(mps.schemes.mps(), alpha=0.0)
    zero = jnp.zeros(())
    carry = (mps.start(case, scheme), loop.Clock(zero, zero, zero, zero), empty_log(case, case.particles))
    program = jax.jit(loop.advance_chunk).lower(case.undescribed(), scheme, carry, None, KEYS[0], jnp.asarray(4))
    told: Any = program.compile().memory_analysis()
    taken = told.temp_size_in_bytes + told.argument_size_in_bytes + told.output_size_in_bytes
    assert 0.2 * bytes_of(case, scheme) < taken < bytes_of(case, scheme)


def test_a_bound_on_memory_bounds_the_batch(swept):
    from jaxmps.ensembles.batch_size import sizes

    member = members(swept[0], swept[1], KEYS)[0]
    each = bytes_of(member.case, member.scheme)
    assert sizes(member, 100, jax.devices()[:1], None, 1.5 * each) == (1, 1)
    assert sizes(member, 100, jax.devices()[:1], 8, 1e12) == (8, 1)
    assert sizes(member, 1, jax.devices()[:1], None, 1e12) == (1, 1)


def test_finished_members_are_not_run_again(swept, many, tmp_path):
    first = mps.ensemble(*swept, keys=KEYS, out=tmp_path, **TIMES)
    np.testing.assert_array_equal(first.position, many.position)
    files = sorted(tmp_path.glob("member-*.h5"))
    assert [path.name for path in files] == [f"member-{k:06d}.h5" for k in range(3)]
    files[1].unlink()
    with pytest.raises(ValueError, match="without 1 of them, the first 1: run the same command again"):
        mps.gather(tmp_path)
    before = {path: path.stat().st_mtime_ns for path in (files[0], files[2])}
    again = mps.ensemble(*swept, keys=KEYS, out=tmp_path, **TIMES)
    assert {path: path.stat().st_mtime_ns for path in before} == before
    for found in (again, mps.gather(tmp_path)):
        np.testing.assert_array_equal(found.position, many.position)
        np.testing.assert_array_equal(found.series["wet"], many.series["wet"])
        assert found.status == many.status and found.values.keys() == many.values.keys()
    with pytest.raises(ValueError, match=r"another: its run.(until|save_every) is 0"):
        mps.ensemble(*swept, keys=KEYS, out=tmp_path, until=0.05)
    with pytest.raises(ValueError, match="another: its members"):
        mps.ensemble(*swept, keys=KEYS[::-1], out=tmp_path, **TIMES)
    more = mps.ensemble(swept[0][0], swept[1][0], keys=KEYS[jnp.array([0, 2])], out=tmp_path / "more", **TIMES)
    larger = mps.ensemble(swept[0][0], swept[1][0], keys=KEYS[jnp.array([0, 2, 1])], out=tmp_path / "more", **TIMES)
    np.testing.assert_array_equal(larger[:2].position, more.position)
    np.testing.assert_array_equal(larger.position[0], many.position[0])
    short = mps.ensemble(*swept, keys=KEYS, out=tmp_path, until=0.05, overwrite=True)
    assert mps.gather(tmp_path).time[-1] == short.time[-1] == 0.05


def test_files_of_ensembles_keep_all_and_open_as_coordinates(many, tmp_path):
    import h5py

    path = tmp_path / "many.h5"
    write_ensemble(path, many)
    found = read_ensemble(path)
    for field in dataclasses.fields(many):
        mine, theirs = getattr(many, field.name), getattr(found, field.name)
        if field.name != "metadata":
            jax.tree.map(np.testing.assert_array_equal, mine, theirs)
    assert found.metadata["scheme"]["name"] == "stochastic mps"
    with h5py.File(path) as file:
        dims = file["series/kinetic"].dims
        assert dims[0][0] == file["member"] and dims[1][0] == file["time"]
        assert file["series/kinetic"].attrs["units"] == "J/kg"
    with pytest.raises(FileExistsError):
        write_ensemble(path, many)
    path.write_bytes(path.read_bytes()[:3000])
    with pytest.raises(ValueError, match="damaged"):
        read_ensemble(path)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"keys": 0}, "keys must be a whole number of 1 or more, got 0"),
        ({"keys": jnp.zeros(3)}, "keys must be a whole number of 1 or more, or an array of keys"),
        ({"until": 0.0}, "until must be greater than zero, got 0 s"),
        ({"batch": 0}, "batch must be a whole number of 1 or more, got 0"),
        ({"memory": -1.0}, "memory must be greater than zero, got -1 bytes"),
        ({"case": [1, 2]}, "case must be one, or one for each of 3 keys, got 2"),
    ],
)
def test_wrong_arguments_are_named(swept, arguments, message, unchecked):
    usual = {"case": swept[0], "scheme": swept[1], "keys": KEYS, "until": 0.01}
    with pytest.raises(ValueError, match=message):
        mps.ensemble(**{**usual, **arguments})


def test_members_of_several_kinds_are_refused(swept):
    cases, schemes = swept
    with pytest.raises(
        ValueError, match=r"every scheme must differ from the first in values alone, not in ratio.*got scheme 2"
    ):
        mps.ensemble(cases, [*schemes[:2], dataclasses.replace(schemes[2], ratio=3.1)], keys=KEYS, until=0.1)
    other = mps.cases.standing_wave(spacing=0.05, floor="mirror")
    with pytest.raises(ValueError, match=r"every case must differ from the first in values alone, not in .*spacing"):
        mps.ensemble([*cases[:2], other], schemes, keys=KEYS, until=0.1)


SWEEP = ["ensemble", "standing_wave", "--spacing", "0.1", "--until", "0.05", "--save-every", "0.05"]
SWEEP += ["--members", "2", "--sweep", "stochastic.alpha=0.01:0.03:2", "--jitter", "0.01"]


def launch(folder: Path, *more: str) -> subprocess.Popen:
    code = "import sys; from jaxmps.command_line.main import main; sys.exit(main(sys.argv[1:]))"
    command = [sys.executable, "-c", code, *SWEEP, "--out", str(folder), *more]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def free_port() -> int:
    import socket

    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    """The sweep by one process, this one."""
    folder = tmp_path_factory.mktemp("alone")
    before, said = jax.config.jax_enable_x64, io.StringIO()  # type: ignore[attr-defined]
    with contextlib.redirect_stdout(said):
        assert main([*SWEEP, "--out", str(folder)]) == 0
    jax.config.update("jax_enable_x64", before)
    assert "ensemble.h5" in said.getvalue() and "ensemble.png" in said.getvalue()
    return read_ensemble(folder / "ensemble.h5")


@pytest.mark.slow
def test_two_processes_make_the_members_of_one(alone, tmp_path):
    where = ["--hosts", f"127.0.0.1:{free_port()}", "--processes", "2", "--process"]
    pair = [launch(tmp_path, *where, str(k)) for k in range(2)]
    for process in pair:
        out, err = process.communicate(timeout=300)
        assert process.returncode == 0, err
        assert f"2 members are in {tmp_path}" in out
    found = mps.gather(tmp_path)
    np.testing.assert_array_equal(found.of("energy"), alone.of("energy"))
    np.testing.assert_array_equal(found.seed, alone.seed)
    np.testing.assert_allclose(found.values["noise.alpha"], [0.01, 0.01, 0.03, 0.03])


@pytest.mark.slow
def test_after_a_kill_only_missing_members_are_computed(alone, tmp_path):
    process = launch(tmp_path)
    first = tmp_path / "member-000000.h5"
    end = time.monotonic() + 200
    while not any(tmp_path.glob("member-*.h5")) and time.monotonic() < end:
        time.sleep(0.002)
    process.kill()
    process.communicate()
    kept = {path: path.stat().st_mtime_ns for path in tmp_path.glob("member-*.h5")}
    assert kept and first.parent == tmp_path
    again = launch(tmp_path)
    _, err = again.communicate(timeout=300)
    assert again.returncode == 0, err
    assert {path: path.stat().st_mtime_ns for path in kept} == kept
    np.testing.assert_array_equal(mps.gather(tmp_path).of("energy"), alone.of("energy"))


@pytest.mark.slow
def test_members_are_shared_out_over_devices_also_where_they_do_not_divide(many, tmp_path):
    code = f"""
import sys
sys.path.insert(0, {str(Path(__file__).parent)!r})
import jax
jax.config.update("jax_enable_x64", True)
jax.config.update("jax_num_cpu_devices", 2)
import hasty
hasty.hurry()
from jaxmps.io import write_ensemble
from test_ensembles import KEYS, TIMES, wave
import jaxmps as mps
assert len(jax.local_devices()) == 2
schemes = [hasty.by_diagonal(mps.schemes.stochastic(mps.schemes.mps(), alpha=alpha)) for alpha in {ALPHAS}]
many = mps.ensemble([wave(k) for k in range(3)], schemes, keys=KEYS, **TIMES)
write_ensemble({str(tmp_path / "many.h5")!r}, many)
"""
    subprocess.run([sys.executable, "-c", code], check=True, timeout=300)
    found = read_ensemble(tmp_path / "many.h5")
    assert found.member.tolist() == [0, 1, 2]
    np.testing.assert_allclose(found.position, many.position, atol=1e-10)


@pytest.mark.slow
def test_a_sweep_is_compiled_once(swept, monkeypatch):
    cases, schemes = swept
    traced = []
    usual = loop.largest_step
    monkeypatch.setattr(loop, "largest_step", lambda *arguments: traced.append(1) or usual(*arguments))
    jax.clear_caches()
    mps.simulate(cases[0], schemes[0], **TIMES)
    once = len(traced)
    jax.clear_caches()
    mps.ensemble(*swept, keys=KEYS, **TIMES)
    assert len(traced) == 2 * once > 0
