"""Runs and schemes in notebooks, and as other libraries know them."""

import base64
import dataclasses
import io
import itertools
import json
import re
from html.parser import HTMLParser
from typing import Any

import nbclient
import nbformat
import numpy as np
import pytest
from PIL import Image
from test_plotting import FRAMES, make_run

import jaxmps as mps
from jaxmps import plotting
from jaxmps.flow import Event, Outcome, Status


class Cells(HTMLParser):
    """The texts of a table's cells."""

    def __init__(self, text: str):
        super().__init__()
        self.found: list[str] = []
        self.tags: list[str] = []
        self.feed(text)
        self.rows = dict(zip(self.found[::2], self.found[1::2], strict=True))

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        if tag in ("th", "td"):
            self.found.append("")

    def handle_data(self, data):
        if self.found:
            self.found[-1] += data


def test_a_run_shows_itself_as_a_table_that_cannot_be_broken_by_its_names():
    event = Event(int(Status.NOT_FINITE), 0.1, 3, 7, (0.1, 0.2))
    metadata = {"case": {"name": "<script>alert(1)</script>"}, "scheme": {"name": "a & b"}}
    run = dataclasses.replace(make_run(), metadata=metadata, status=Outcome((event,)), summary={"steps": 12})
    cells = Cells(run._repr_html_())
    assert cells.rows["case"] == "<script>alert(1)</script>" and cells.rows["scheme"] == "a & b"
    assert set(cells.tags) == {"table", "caption", "b", "tr", "th", "td"}
    assert cells.rows["particles"] == "94 in 2-D, at the end 50 fluid, 22 wall, 22 dummy"
    assert cells.rows["frames"] == "4, t = 0 to 0.15 s" and cells.rows["steps"] == "12"
    assert cells.rows["status"] == str(event) and cells.rows["advice"] == event.advice
    assert "advice" not in Cells(make_run()._repr_html_()).rows


def test_a_scheme_shows_its_models_and_values():
    rows = Cells(mps.schemes.mps(relaxation=0.125)._repr_html_()).rows
    assert rows["source"] == "DensityDeviation" and float(rows["source.relaxation"]) == 0.125
    assert rows["max_iterations"] == "2000" and rows["clip_pressure"] == "True"


@pytest.mark.parametrize("dim", [2, 3])
def test_xarray_has_every_array_with_dimensions_and_units(dim):
    run = make_run(dim)
    data = run.to_xarray()
    assert dict(data.sizes) == {"time": FRAMES, "particle": run.kind.shape[1], "axis": dim}
    assert data.position.dims == ("time", "particle", "axis") and list(data.axis.values) == list("xyz"[:dim])
    units = {"position": "m", "velocity": "m/s", "pressure": "Pa", "density": "kg/m^3", "time": "s", "spacing": "m"}
    assert {name: data[name].attrs["units"] for name in units} == units
    for name in ("position", "velocity", "pressure", "number_density", "surface", "kind", "phase", "density", "time"):
        np.testing.assert_array_equal(data[name].values, getattr(run, name), err_msg=name)
    # The fluid slides at 2 m/s: half of the square of it is its kinetic energy.
    np.testing.assert_allclose(data.kinetic_energy, 0.5 * 2.0**2)
    speeds = data.velocity.sel(axis="x").where(data.kind == mps.Kind.FLUID).mean("particle")
    np.testing.assert_allclose(speeds, 2.0)
    assert data.kind.attrs["flag_meanings"].split()[data.kind.attrs["flag_values"].tolist().index(1)] == "wall"
    assert (data.attrs["case"], data.attrs["scheme"], data.attrs["status"]) == ("dam_break", "mps", "completed")


@pytest.mark.parametrize("dim", [2, 3])
def test_pyvista_gets_a_frame_with_all_its_point_data(dim):
    run = make_run(dim)
    cloud = run.to_pyvista(1)
    assert cloud.n_points == cloud.n_verts == run.kind.shape[1]
    np.testing.assert_array_equal(cloud.points[:, :dim], run.position[1])
    np.testing.assert_array_equal(cloud.points[:, dim:], 0.0)
    np.testing.assert_array_equal(cloud["velocity"][:, :dim], run.velocity[1])
    for name in ("pressure", "number_density", "surface", "kind"):
        np.testing.assert_array_equal(cloud[name], getattr(run, name)[1], err_msg=name)
    np.testing.assert_array_equal(cloud["density"], run.density)
    assert cloud.field_data["TimeValue"] == pytest.approx(0.05)
    fluid = cloud.threshold(0.5, scalars="kind", invert=True)
    assert fluid.n_points == np.sum(run.kind[1] == mps.Kind.FLUID)
    with pytest.raises(IndexError, match="frame must be between -4 and 3, got 4"):
        run.to_pyvista(4)


def test_a_package_that_is_not_there_is_named_with_the_way_to_get_it():
    from jaxmps.results import needed

    with pytest.raises(ImportError, match=r"no_such_package is needed for this: pip install 'jaxmps\[exchange\]'"):
        needed("no_such_package")


def pictures(player: plotting.Player) -> list[np.ndarray]:
    found = re.search(r"const frames = (\[.*?\])", player._repr_html_())
    assert found is not None
    encoded = json.loads(found[1])
    return [np.asarray(Image.open(io.BytesIO(base64.b64decode(text))).convert("RGB")) for text in encoded]


@pytest.mark.parametrize("dim", [2, 3])
def test_a_player_has_a_picture_for_each_place_of_its_slider(dim, tmp_path):
    player = plotting.player(make_run(dim), "speed", dpi=50.0)
    images = pictures(player)
    assert len(images) == FRAMES == len(player.frames) and f'max="{FRAMES - 1}"' in player.html
    assert len({image.shape for image in images}) == 1
    assert all(np.any(a != b) for a, b in itertools.pairwise(images))
    page = player.save(tmp_path / "run.html").read_text()
    assert player.html in page and page.startswith("<!doctype html>")
    # It stands by itself.
    assert not re.search(r"https?:|src=\"(?!data)", page)
    assert plotting.player(make_run(dim), dpi=50.0).html.split('"')[1] != player.html.split('"')[1]


def test_a_player_of_a_long_run_is_thinned_and_keeps_both_ends():
    run = make_run(frames=30)
    player = plotting.player(run, most=5, dpi=50.0)
    assert player.frames == (0, 7, 14, 22, 29) and len(pictures(player)) == 5
    wrong: tuple[tuple[dict[str, Any], str], ...] = (
        ({"fps": 0.0}, "fps must be"),
        ({"most": 1}, "most must be"),
        ({"color": "red"}, "color"),
    )
    for arguments, fault in wrong:
        with pytest.raises(ValueError, match=fault):
            plotting.player(run, **arguments)


def test_a_notebook_shows_tables_a_player_and_a_bar_that_moves(tmp_path):
    lines = ["import sys, time", f"sys.path[:0] = {[str(p) for p in __import__('sys').path if p]!r}"]
    source = [
        "from test_plotting import make_run\nfrom jaxmps import plotting\nmake_run()",
        "plotting.player(make_run(), dpi=50.0)",
        "from jaxmps.running.progress import meter\nwith meter(2.0, None) as bar:\n"
        "    for k in range(5):\n        bar.update(0.4 * k, 1e-3, 1.5)\n        time.sleep(0.15)",
    ]
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(text) for text in ["\n".join(lines), *source]])
    seen: list[str] = []

    client = nbclient.NotebookClient(notebook, timeout=60, kernel_name="python3")
    original = client.process_message

    def process(message, cell, index):
        if message["msg_type"] in ("display_data", "update_display_data"):
            seen.append(str(message["content"]["data"]))
        return original(message, cell, index)

    client.process_message = process  # type: ignore[method-assign]
    client.execute(cwd=str(tmp_path))
    shown = [[o.get("data", {}).get("text/html", "") for o in cell.outputs] for cell in notebook.cells]
    assert any("dam_break" in text and "<table>" in text for text in shown[1])
    assert any('type="range"' in text for text in shown[2])
    times = {time for text in seen for time in re.findall(r"t (\d\.\d{3}) s of 2", text)}
    assert len(times) >= 3, seen
    assert not any(o.output_type == "error" for cell in notebook.cells for o in cell.outputs)
