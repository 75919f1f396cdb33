"""Probes against closed forms: linear pressure in water at rest, and a surface that is flat."""

import dataclasses

import numpy as np
import pytest

from jaxmps import Kind, Run, cases
from jaxmps.diagnostics import Probe, pressure_along, pressure_at, probes, wave_height

RHO_G = 1000.0 * 9.81


def at_rest(depth: float | None = None, spacing: float = 0.02) -> Run:
    """Two frames of water at rest, 0.4 m deep, with its exact pressure; the second is half as dense."""
    case = cases.hydrostatic(spacing=spacing, depth=depth)
    position, kind = np.asarray(case.particles.position), np.asarray(case.particles.kind)
    pressure = np.where(kind == Kind.DUMMY, 0.0, RHO_G * np.maximum(0.4 - position[:, -1], 0.0))
    count = len(kind)
    return Run(
        time=np.array([0.0, 0.1]),
        position=np.stack([position, position]),
        velocity=np.zeros((2, *position.shape)),
        pressure=np.stack([pressure, 0.5 * pressure]),
        number_density=np.zeros((2, count)),
        surface=np.zeros((2, count), bool),
        kind=np.stack([kind, kind]),
        phase=np.zeros(count, int),
        density=np.full(count, 1000.0),
        spacing=spacing,
        energy=np.zeros((2, 2)),
    )


def test_pressure_at_a_point_is_hydrostatic_inside_and_at_walls():
    points = [[0.2, 0.2], [0.113, 0.157], [0.2, 0.0], [0.0, 0.1]]
    expected = RHO_G * (0.4 - np.array([0.2, 0.157, 0.0, 0.1]))
    found = pressure_at(at_rest(), points)
    assert found[0] == pytest.approx(expected, rel=0.03)
    assert found[1] == pytest.approx(0.5 * found[0])


def test_pressure_at_a_point_is_hydrostatic_in_three_dimensions():
    found = pressure_at(at_rest(depth=0.2, spacing=0.04), [[0.2, 0.1, 0.2]], radius=0.1)
    assert found[0] == pytest.approx(RHO_G * 0.2, rel=0.03)


def test_pressure_in_the_air_and_at_a_dry_wall_is_zero():
    assert not pressure_at(at_rest(), [[0.2, 0.7], [0.0, 0.58], [5.0, 5.0]]).any()


def test_mean_pressure_along_a_wall_is_that_of_half_its_depth():
    run = at_rest()
    points, pressure = pressure_along(run, (0.0, 0.0), (0.0, 0.4))
    assert points.shape == (20, 2) and np.allclose(points[:, 1], 0.02 * (np.arange(20) + 0.5))
    assert pressure[0].mean() == pytest.approx(RHO_G * 0.2, rel=0.02)


@pytest.mark.parametrize(("depth", "place"), [(None, 0.2), (None, 0.013), (0.2, (0.2, 0.1))])
def test_height_of_a_flat_surface_is_found_within_half_a_spacing(depth, place):
    run = at_rest(depth, 0.02 if depth is None else 0.05)
    assert wave_height(run, place) == pytest.approx(0.4, abs=0.5 * run.spacing)


def test_spray_above_the_water_does_not_count_and_a_dry_place_has_no_height():
    run = at_rest()
    position = run.position.copy()
    drop = np.flatnonzero(run.fluid[0] & (position[0, :, 0] > 0.38))[-1]
    position[:, drop] = (0.2, 0.9)
    run = dataclasses.replace(run, position=position)
    assert wave_height(run, 0.2) == pytest.approx(0.4)
    assert np.isnan(wave_height(run, 3.0)).all()


def test_probes_are_columns_with_units():
    instruments = [
        Probe("middle", "pressure", ((0.2, 0.2),)),
        Probe("side", "wall_pressure", ((0.0, 0.0), (0.0, 0.4))),
        Probe("gauge", "wave_gauge", ((0.2,),)),
        Probe("front", "front"),
    ]
    table = probes(at_rest(), instruments)
    assert list(table) == ["time [s]", "middle [Pa]", "side [Pa]", "gauge [m]", "front [m]"]
    assert table["front [m]"] == pytest.approx(0.4)
    assert table["side [Pa]"][1] == pytest.approx(0.25 * RHO_G * 0.4, rel=0.02)


def test_wrong_probes_are_told():
    run = at_rest()
    with pytest.raises(ValueError, match="points must have 2 components, got 3"):
        pressure_at(run, [[0.0, 0.0, 0.0]])
    with pytest.raises(ValueError, match="radius must be greater than zero"):
        pressure_at(run, [[0.0, 0.0]], radius=-1.0)
    with pytest.raises(ValueError, match="place must have 1 components, got 2"):
        wave_height(run, (0.0, 0.0))
    with pytest.raises(ValueError, match="kind must be one of pressure"):
        Probe("x", "presure").measure(run)
