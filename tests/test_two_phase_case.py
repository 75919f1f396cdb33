"""Two-phase cases: grains in water and layers, their exact pressure and first accelerations."""

import jax
import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.linalg import spsolve

from jaxmps import Case, Kind
from jaxmps.cases import (
    SETTLING_ACCELERATION,
    SURFACING_ACCELERATION,
    grain_groups,
    jitter,
    settling,
    surfacing,
    two_layer,
    two_layer_pressure,
)

GRAINS = [settling, surfacing]


def groups(case: Case) -> np.ndarray:
    return grain_groups(case.particles.position, case.particles.phase)


@pytest.mark.parametrize("precision", ["single", "double"], indirect=True)
@pytest.mark.parametrize("make", GRAINS)
def test_there_are_7000_fluid_particles_and_80_in_each_of_five_groups(make, precision):
    case = make()
    kind, phase = np.asarray(case.particles.kind), np.asarray(case.particles.phase)
    # The inner wall and two layers of dummies: 100 columns inside, 80 rows above the floor.
    assert np.bincount(kind).tolist() == [7000, 102 + 2 * 80, 2 * 81 + 2 * 82 + 2 * 105]
    assert np.bincount(phase[kind == Kind.FLUID]).tolist() == [6600, 400]
    assert np.all(phase[kind != Kind.FLUID] == 0)
    assert np.bincount(groups(case) + 1).tolist() == [len(kind) - 400, 80, 80, 80, 80, 80]


def test_water_is_as_deep_and_the_tank_as_large_as_in_the_paper():
    case = settling()
    position, kind = np.asarray(case.particles.position), np.asarray(case.particles.kind)
    fluid, wall = position[kind == Kind.FLUID], position[kind == Kind.WALL]
    np.testing.assert_allclose(fluid.min(axis=0) - 0.00125, 0.0, atol=1e-12)
    np.testing.assert_allclose(fluid.max(axis=0) + 0.00125, [0.25, 0.175], rtol=1e-12)
    assert wall[:, 1].max() + 0.00125 == pytest.approx(0.2)
    assert np.all(np.asarray(case.particles.velocity) == 0.0)


@pytest.mark.parametrize(("make", "grains"), [(settling, 2650.0), (surfacing, 600.0)])
def test_grains_have_their_density_and_water_its_own(make, grains):
    case = make()
    assert case.name == make.__name__
    assert np.asarray(case.fluids.density).tolist() == [1000.0, grains]
    assert np.asarray(case.fluids.viscosity).tolist() == [0.0, 0.0]
    np.testing.assert_array_equal(case.density, np.where(groups(case) >= 0, grains, 1000.0))
    changed = make(density=1100.0, grain_density=900.0, viscosity=1e-6, grain_viscosity=2e-6)
    assert np.asarray(changed.fluids.density).tolist() == [1100.0, 900.0]
    assert np.asarray(changed.fluids.viscosity).tolist() == [1e-6, 2e-6]


@pytest.mark.parametrize("spacing", [0.001, 0.00125, 0.0025, 0.005])
def test_groups_are_discs_around_their_centers_with_nothing_of_another_phase(spacing):
    case = settling(spacing=spacing)
    position, group = np.asarray(case.particles.position), groups(case)
    for k in range(5):
        far = np.hypot(position[:, 0] - 0.025 * (k + 1), position[:, 1] - 0.071 - 0.0175 * k)
        assert far[group == k].max() <= 0.0125 * (1.0 + 1e-9)
        assert far[group == -1].min() > 0.0125
        # Each group holds the area of its circle; a lattice of few particles counts it less well.
        assert np.sum(group == k) * spacing**2 == pytest.approx(np.pi * 0.0125**2, rel=0.1)


def test_a_particle_on_the_rim_belongs_to_the_group():
    # At 1 mm a particle stands 12.5 mm beside the center (0.05, 0.0885) of B.
    case = settling(spacing=0.001)
    rim = np.all(np.isclose(np.asarray(case.particles.position), [0.0625, 0.0885], atol=1e-9), axis=1)
    assert np.sum(rim) == 1
    assert groups(case)[rim] == 1


def test_groups_are_known_after_a_jitter_too():
    case = settling()
    np.testing.assert_array_equal(groups(jitter(case, 0.3, jax.random.key(0))), groups(case))


def first_acceleration(case: Case) -> np.ndarray:
    """Mean acceleration (a_x, a_y) of each group, by finite volumes with the fluid particles as cells.

    ∇·(∇p/ρ) = 0 inside, (1/ρ) ∂p/∂n = g·n on walls and floor, p = 0 on the surface. Faces have the mean density.
    """
    fluid = np.asarray(case.particles.fluid)
    l0, g = case.spacing, -float(case.gravity[1])
    columns = round(0.25 / l0)
    density = np.asarray(case.density)[fluid].reshape(columns, -1)
    across, along = 2.0 / (density[1:] + density[:-1]), 2.0 / (density[:, 1:] + density[:, :-1])
    above = 2.0 / density[:, -1]
    cell = np.arange(density.size).reshape(density.shape)
    i, j = (np.concatenate([a.ravel(), b.ravel()]) for a, b in ((cell[1:], cell[:, 1:]), (cell[:-1], cell[:, :-1])))
    b = np.concatenate([across.ravel(), along.ravel()])
    top = cell[:, -1]
    matrix = coo_array(
        (
            np.concatenate([b, b, -b, -b, above]),
            (np.concatenate([i, j, i, j, top]), np.concatenate([i, j, j, i, top])),
        )
    )
    weight = np.zeros(density.shape)
    weight[:, 0] = g * l0
    p = np.asarray(spsolve(matrix.tocsc(), weight.ravel())).reshape(density.shape)
    a_x, a_y = np.zeros((columns + 1, density.shape[1])), np.zeros((columns, density.shape[1] + 1))
    a_x[1:-1] = -across * np.diff(p, axis=0) / l0
    a_y[:, 1:-1] = -along * np.diff(p, axis=1) / l0 - g
    a_y[:, -1] = above * p[:, -1] / l0 - g
    inside = np.stack([a_x[1:] + a_x[:-1], a_y[:, 1:] + a_y[:, :-1]], axis=-1).reshape(-1, 2) / 2.0
    group = groups(case)[fluid]
    return np.array([inside[group == k].mean(axis=0) for k in range(5)])


@pytest.mark.parametrize(("make", "known"), [(settling, SETTLING_ACCELERATION), (surfacing, SURFACING_ACCELERATION)])
def test_known_first_accelerations_solve_the_pressure_equation(make, known):
    # They come from half this spacing; from 2.5 to 1.25 mm a_y changes by 5 %, then by 1 % (settling), as it converges.
    np.testing.assert_allclose(first_acceleration(make(spacing=0.00125)), known, rtol=0.02)


def test_two_layer_has_the_lighter_fluid_above_and_walls_of_phase_0():
    case = two_layer(spacing=0.02, length=0.2, lower_height=0.06, upper_height=0.1, freeboard=0.04)
    kind, phase = np.asarray(case.particles.kind), np.asarray(case.particles.phase)
    elevation = np.asarray(case.particles.position)[:, 1]
    fluid = kind == Kind.FLUID
    assert np.bincount(phase[fluid]).tolist() == [10 * 3, 10 * 5]
    assert elevation[fluid & (phase == 0)].max() == pytest.approx(0.05)
    assert elevation[fluid & (phase == 1)].min() == pytest.approx(0.07)
    assert elevation[kind == Kind.WALL].max() == pytest.approx(0.19)
    assert np.all(phase[~fluid] == 0)
    np.testing.assert_array_equal(np.asarray(case.density)[fluid], np.where(elevation[fluid] < 0.06, 1000.0, 600.0))


def test_two_layer_pressure_is_the_weight_above():
    # 1 m of 600 kg/m³ on 2 m of 1000 kg/m³, g = 10 m/s².
    found = two_layer_pressure(np.array([0.0, 1.0, 2.0, 2.5, 3.0, 4.0]), 2.0, 3.0, 1000.0, 600.0, 10.0)
    np.testing.assert_allclose(found, [26000.0, 16000.0, 6000.0, 3000.0, 0.0, 0.0], rtol=1e-13)
    heavier_above = two_layer_pressure(np.array([0.0, 2.0, 3.5]), 2.0, 3.0, 1000.0, 2650.0, 10.0)
    np.testing.assert_allclose(heavier_above, [46500.0, 26500.0, 0.0], rtol=1e-13)


BAD = [0.0, -1.0, float("nan"), float("inf"), float("-inf"), "0.1", None, True, 1j, [0.1]]
OF_GRAINS = ("spacing", "density", "grain_density", "viscosity", "grain_viscosity", "gravity", "ratio")
OF_LAYERS = (
    *("spacing", "length", "lower_height", "upper_height", "freeboard", "lower_density", "upper_density"),
    *("lower_viscosity", "upper_viscosity", "gravity", "ratio"),
)
ARGUMENTS = [*((make, name) for make in GRAINS for name in OF_GRAINS), *((two_layer, name) for name in OF_LAYERS)]


@pytest.mark.parametrize(("make", "name"), ARGUMENTS, ids=lambda x: getattr(x, "__name__", x))
def test_bad_argument_is_refused_by_name_and_value(unchecked, make, name):
    for value in BAD:
        if value == 0.0 and name in ("viscosity", "grain_viscosity", "lower_viscosity", "upper_viscosity"):
            continue
        if value == 0.0 and name in ("gravity", "freeboard"):
            continue
        shown = f"{value:g}" if isinstance(value, float) else repr(value)
        with pytest.raises(ValueError) as caught:
            make(**{name: value})
        assert str(caught.value).startswith(f"{name} must be")
        assert shown in str(caught.value)


@pytest.mark.parametrize(
    ("make", "arguments", "said"),
    [
        (settling, {"spacing": 0.02}, r"spacing must be at most the radius of a group \(0.0125 m\), got 0.02 m"),
        (two_layer, {"spacing": 0.15}, r"spacing must be at most lower_height \(0.1 m\), got 0.15 m"),
        (two_layer, {"upper_height": 0.001}, r"spacing must be at most upper_height \(0.001 m\), got 0.01 m"),
    ],
)
def test_lengths_that_do_not_fit_are_refused_with_their_limit(make, arguments, said):
    with pytest.raises(ValueError, match=said):
        make(**arguments)
