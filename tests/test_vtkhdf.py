"""The files of runs, as viewers see them and as `read` does."""

import os
import resource
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jaxmps.flow import Outcome
from jaxmps.io import Writer, read

vtk = pytest.importorskip("vtk")
from vtkmodules.util.numpy_support import vtk_to_numpy  # noqa: E402

PARTICLES = 40
FRAMES = 3
LAYOUTS = pytest.mark.parametrize(("dim", "dtype"), [(2, "f8"), (3, "f4")], ids=["2d", "3d"])
PHASE = np.arange(PARTICLES, dtype=np.int32) % 2
DENSITY = np.where(PHASE == 0, 1000.0, 800.0)
METADATA = {
    "case": {"name": "tank", "width": 0.5, "fluids": ["sea water", "Öl"]},
    "scheme": {"name": "mps"},
    "run": {"seed": 7},
}


def frame(k: int, dim: int, dtype: str) -> dict[str, Any]:
    rng = np.random.default_rng(k)
    return {
        "time": 0.1 * k,
        "position": rng.normal(size=(PARTICLES, dim)).astype(dtype),
        "velocity": rng.normal(size=(PARTICLES, dim)).astype(dtype),
        "pressure": rng.normal(size=PARTICLES).astype(dtype),
        "number_density": rng.random(PARTICLES).astype(dtype),
        "surface": rng.random(PARTICLES) > 0.5,
        "kind": rng.integers(0, 4, PARTICLES).astype(np.int8),
        "energy": np.array([1.0 + k, 2.0]),
    }


def start(path: Path, dim: int = 2, dtype: str = "f8", overwrite: bool = False) -> Writer:
    return Writer(
        path,
        phase=PHASE,
        density=DENSITY,
        spacing=0.02,
        dim=dim,
        dtype=dtype,
        metadata=METADATA,
        overwrite=overwrite,
    )


def write(path: Path, dim: int = 2, dtype: str = "f8") -> list[dict[str, Any]]:
    writer, frames = start(path, dim, dtype), [frame(k, dim, dtype) for k in range(FRAMES)]
    for values in frames:
        writer.append(**values)
    writer.finish(Outcome().to_dict(), {"steps": 12})
    return frames


def vtk_reader(path: Path) -> Any:
    reader = vtk.vtkHDFReader()
    reader.SetFileName(str(path))
    reader.UpdateInformation()
    return reader


def padded(values: np.ndarray) -> np.ndarray:
    return np.pad(values, ((0, 0), (0, 3 - values.shape[1])))


@LAYOUTS
def test_vtk_reads_the_time_of_every_step(tmp_path: Path, dim: int, dtype: str) -> None:
    write(tmp_path / "run.vtkhdf", dim, dtype)
    reader = vtk_reader(tmp_path / "run.vtkhdf")
    times = reader.GetOutputInformation(0).Get(vtk.vtkStreamingDemandDrivenPipeline.TIME_STEPS())
    assert reader.GetNumberOfSteps() == FRAMES
    assert times == tuple(0.1 * k for k in range(FRAMES))


@LAYOUTS
def test_vtk_reads_every_field_of_every_step(tmp_path: Path, dim: int, dtype: str) -> None:
    frames = write(tmp_path / "run.vtkhdf", dim, dtype)
    reader = vtk_reader(tmp_path / "run.vtkhdf")
    for k, values in enumerate(frames):
        reader.SetStep(k)
        reader.Update()
        output = reader.GetOutput()
        data = output.GetPointData()
        arrays = [data.GetArray(i) for i in range(data.GetNumberOfArrays())]
        found = {array.GetName(): vtk_to_numpy(array) for array in arrays}
        found["position"] = vtk_to_numpy(output.GetPoints().GetData())
        expected = {name: values[name] for name in values if name not in ("time", "energy")}
        expected |= {"phase": PHASE, "density": DENSITY}
        expected |= {name: padded(values[name]) for name in ("position", "velocity")}
        assert found.keys() == expected.keys()
        for name, array in expected.items():
            np.testing.assert_array_equal(found[name], array, err_msg=f"{name} of step {k}")
        assert found["position"].dtype == np.dtype(dtype)
        assert (output.GetNumberOfVerts(), output.GetNumberOfCells()) == (PARTICLES, PARTICLES)


def test_vtk_reads_the_names_of_phases_in_every_step(tmp_path: Path) -> None:
    write(tmp_path / "run.vtkhdf")
    reader = vtk_reader(tmp_path / "run.vtkhdf")
    for k in range(FRAMES):
        reader.SetStep(k)
        reader.Update()
        names = reader.GetOutput().GetFieldData().GetAbstractArray("phase_names")
        assert [names.GetValue(i) for i in range(names.GetNumberOfValues())] == ["sea water", "Öl"]
    assert read(tmp_path / "run.vtkhdf").phase_names == ["sea water", "Öl"]


@LAYOUTS
def test_pyvista_opens_the_file_as_it_is(tmp_path: Path, dim: int, dtype: str) -> None:
    pyvista = pytest.importorskip("pyvista")
    frames = write(tmp_path / "run.vtkhdf", dim, dtype)
    cloud = pyvista.read(tmp_path / "run.vtkhdf")
    assert isinstance(cloud, pyvista.PolyData)
    np.testing.assert_array_equal(cloud.points, padded(frames[0]["position"]))
    np.testing.assert_array_equal(cloud.point_data["pressure"], frames[0]["pressure"])


@LAYOUTS
def test_pyvista_goes_through_all_times_with_all_fields(tmp_path: Path, dim: int, dtype: str) -> None:
    pyvista = pytest.importorskip("pyvista")
    frames = write(tmp_path / "run.vtkhdf", dim, dtype)
    reader = pyvista.get_reader(tmp_path / "run.vtkhdf")
    assert reader.reader.GetNumberOfSteps() == FRAMES
    for k, values in reversed(list(enumerate(frames))):
        reader.reader.SetStep(k)  # its HDFReader has no times of its own, and passes on those of VTK
        cloud = reader.read()
        assert cloud.n_points == cloud.n_verts == PARTICLES
        np.testing.assert_array_equal(cloud.points, padded(values["position"]))
        np.testing.assert_array_equal(cloud["velocity"], padded(values["velocity"]))
        for name in ("pressure", "number_density", "surface", "kind"):
            np.testing.assert_array_equal(cloud[name], values[name], err_msg=f"{name} of step {k}")
        np.testing.assert_array_equal(cloud["phase"], PHASE)
        np.testing.assert_array_equal(cloud["density"], DENSITY)


@LAYOUTS
def test_read_gives_back_what_was_written(tmp_path: Path, dim: int, dtype: str) -> None:
    frames = write(tmp_path / "run.vtkhdf", dim, dtype)
    run = read(tmp_path / "run.vtkhdf")
    for name in frames[0]:
        stored = getattr(run, name)
        np.testing.assert_array_equal(stored, np.array([values[name] for values in frames]))
    np.testing.assert_array_equal(run.phase, PHASE)
    np.testing.assert_array_equal(run.density, DENSITY)
    assert run.position.dtype == run.velocity.dtype == run.pressure.dtype == np.dtype(dtype)
    assert (run.surface.dtype, run.kind.dtype, run.phase.dtype) == (bool, np.int8, np.int32)
    assert (len(run), run.spacing, run.status, run.summary) == (
        FRAMES,
        0.02,
        Outcome(),
        {"steps": 12},
    )
    assert {key: run.metadata[key] for key in METADATA} == METADATA
    assert run.metadata["units"]["pressure"] == "Pa"
    assert "tank" in repr(run) and f"{FRAMES} frames" in repr(run)


def test_run_killed_by_sigkill_keeps_the_frames_it_has_saved(tmp_path: Path) -> None:
    path = tmp_path / "run.vtkhdf"
    script = (
        "import pathlib, sys, time; import test_vtkhdf as t\n"
        "writer = t.start(pathlib.Path(sys.argv[1]))\n"
        "for k in range(t.FRAMES): writer.append(**t.frame(k, 2, 'f8'))\n"
        "print('saved', flush=True); time.sleep(60)"
    )
    folders = [str(Path(__file__).parent), *filter(None, sys.path)]
    child = subprocess.Popen(
        [sys.executable, "-c", script, str(path)],
        stdout=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(folders)},
    )
    with child:
        assert child.stdout is not None and child.stdout.readline() == b"saved\n"
        child.send_signal(signal.SIGKILL)
    run = read(path)
    assert vtk_reader(path).GetNumberOfSteps() == len(run) == FRAMES
    np.testing.assert_array_equal(run.position[-1], frame(FRAMES - 1, 2, "f8")["position"])
    assert not run.status.completed and run.summary == {}


def test_write_that_fails_is_one_error_and_the_file_is_brought_back_to_its_image(tmp_path: Path) -> None:
    path = tmp_path / "run.vtkhdf"
    writer, frames = start(path), [frame(k, 2, "f8") for k in range(FRAMES)]
    for values in frames[:2]:
        writer.append(**values)
    image = writer.image()
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (path.stat().st_size + 1000, hard))
    try:
        with pytest.raises(OSError, match=r"run\.vtkhdf could not be written: File too large$"):
            writer.append(**frames[2])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    again = Writer.restored(path, image)
    times, energies = again.history()
    assert (times.tolist(), energies[:, 0].tolist()) == ([0.0, 0.1], [1.0, 2.0])
    again.append(**frames[2])
    np.testing.assert_array_equal(read(path).position, [values["position"] for values in frames])


def test_frame_is_added_while_a_viewer_has_the_file_open(tmp_path: Path) -> None:
    path = tmp_path / "run.vtkhdf"
    writer = start(path)
    writer.append(**frame(0, 2, "f8"))
    reader = vtk_reader(path)
    reader.Update()
    writer.append(**frame(1, 2, "f8"))
    assert reader.GetNumberOfSteps() == 1
    assert len(read(path)) == vtk_reader(path).GetNumberOfSteps() == 2


def test_existing_file_is_refused_and_left_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "run.vtkhdf"
    path.write_bytes(b"something else")
    with pytest.raises(FileExistsError, match=rf"^{path} exists already: .*$"):
        start(path)
    assert path.read_bytes() == b"something else"
    start(path, overwrite=True)
    assert len(read(path)) == 0


def test_missing_folders_are_made_and_a_file_in_their_place_is_refused(tmp_path: Path) -> None:
    start(tmp_path / "a" / "b" / "run.vtkhdf")
    (tmp_path / "file").touch()
    with pytest.raises(NotADirectoryError, match="file is not a folder"):
        start(tmp_path / "file" / "run.vtkhdf")


def test_frame_of_another_shape_is_refused_and_not_counted(tmp_path: Path) -> None:
    writer = start(tmp_path / "run.vtkhdf")
    with pytest.raises(ValueError, match=r"position must have shape \(40, 2\), got \(40, 3\)"):
        writer.append(**{**frame(0, 2, "f8"), "position": np.zeros((PARTICLES, 3))})
    assert len(read(writer.path)) == 0


def test_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"no run at .*none\.vtkhdf"):
        read(tmp_path / "none.vtkhdf")


@pytest.mark.parametrize("content", ["text", "other_hdf5", "cut"])
def test_file_that_is_not_a_whole_run_is_named(tmp_path: Path, content: str) -> None:
    path = tmp_path / "run.vtkhdf"
    if content == "text":
        path.write_text("not a run")
    elif content == "other_hdf5":
        h5py = pytest.importorskip("h5py")
        h5py.File(path, "w").close()
    else:
        write(path)
        path.write_bytes(path.read_bytes()[:-4000])
    with pytest.raises(ValueError, match=rf"^{path} is (not a jaxmps run|damaged)"):
        read(path)
