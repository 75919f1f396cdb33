"""The ready-made cases, and what makes a case valid."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial import cKDTree

import jaxmps
from jaxmps import Box, Case, Fluid, Kind, Particles, cases
from jaxmps.cases import dam_break, dam_break_3d, hydrostatic, hydrostatic_pressure, jitter
from jaxmps.flow import at_rest
from jaxmps.kernels import lattice


def counts(case: Case) -> tuple[int, ...]:
    kind = np.asarray(case.particles.kind)
    return tuple(int(np.sum(kind == k)) for k in (Kind.FLUID, Kind.WALL, Kind.DUMMY))


def tank_counts(sides: tuple[int, ...], wall_rows: int, thick: int) -> tuple[int, int]:
    """Wall and dummy particles around an inner space of so many lattice points: shells of boxes open at the top."""

    def shell(t: int) -> int:
        return int(np.prod([side + 2 * t for side in sides]) * (wall_rows + t))

    return (
        int(np.prod([side + 2 for side in sides]) * (wall_rows + 1)) - shell(0),
        shell(thick) - int(np.prod([side + 2 for side in sides]) * (wall_rows + 1)),
    )


def test_dam_break_has_the_2171_particles_of_the_paper():
    # [N11] 5.1: 25 x 50 fluid; three rows of 107 and six columns of 100 of walls, 303 of them in the innermost layer.
    assert counts(dam_break()) == (25 * 50, 303, 618)
    assert len(dam_break().particles.kind) == 2171 == 25 * 50 + 3 * 107 + 6 * 100


@pytest.mark.parametrize(("ratio", "thick"), [(1.5, 2), (2.0, 2), (2.1, 3), (3.0, 3), (3.1, 4), (4.0, 4)])
def test_dam_break_has_the_walls_that_its_radius_needs(ratio, thick):
    case = dam_break(spacing=0.1, ratio=ratio)
    assert counts(case) == (5 * 10, *tank_counts((21,), 20, thick))


def test_dam_break_3d_fills_its_tank_from_side_to_side():
    # 0.3 x 0.4 x 0.4 m of fluid in a tank of 1.0 x 0.4 x 0.5 m, at spacings of 0.02 and 0.05 m.
    assert counts(dam_break_3d()) == (15 * 20 * 20, *tank_counts((51, 20), 25, 3))
    assert counts(dam_break_3d(spacing=0.05)) == (6 * 8 * 8, *tank_counts((21, 8), 10, 3))


@pytest.mark.parametrize("ratio", [2.1, 3.1])
def test_hydrostatic_tank_has_a_row_of_fluid_for_each_spacing(ratio):
    thick = 3 if ratio == 2.1 else 4
    flat = hydrostatic(spacing=0.1, length=0.6, height=0.5, freeboard=0.2, ratio=ratio)
    assert counts(flat) == (6 * 5, *tank_counts((6,), 7, thick))
    deep = hydrostatic(spacing=0.1, length=0.6, depth=0.3, height=0.5, freeboard=0.2, ratio=ratio)
    assert counts(deep) == (6 * 3 * 5, *tank_counts((6, 3), 7, thick))


@pytest.mark.parametrize("make", [dam_break, dam_break_3d, hydrostatic])
def test_particles_stand_in_the_middle_of_the_cells_of_a_lattice_and_each_has_its_own(make):
    case = make()
    cell = np.asarray(case.particles.position) / case.spacing - 0.5
    np.testing.assert_allclose(cell, np.round(cell), atol=1e-10)
    assert len(np.unique(np.round(cell), axis=0)) == len(cell)


@pytest.mark.parametrize(
    ("case", "lengths"),
    [
        (dam_break(), (0.5, 1.0)),
        (dam_break_3d(), (0.3, 0.4, 0.4)),
        (hydrostatic(), (0.4, 0.4)),
        (hydrostatic(spacing=0.1, length=0.5, depth=0.3, height=0.4), (0.5, 0.3, 0.4)),
    ],
    ids=["dam_break", "dam_break_3d", "hydrostatic", "hydrostatic_3d"],
)
def test_fluid_is_a_block_with_its_lower_corner_at_the_origin(case, lengths):
    fluid = np.asarray(case.particles.position)[np.asarray(case.particles.fluid)]
    half = 0.5 * case.spacing
    # Positions were made in single precision or in double.
    np.testing.assert_allclose(fluid.min(axis=0) - half, 0.0, atol=1e-6)
    np.testing.assert_allclose(fluid.max(axis=0) + half, lengths, atol=1e-6)
    assert np.all(np.asarray(case.particles.velocity) == 0)
    assert np.all(np.asarray(case.particles.pressure) == 0)
    assert np.asarray(case.gravity)[-1] == pytest.approx(-9.81)
    assert np.all(np.asarray(case.gravity)[:-1] == 0)


def test_fluid_comes_first():
    kind = np.asarray(dam_break().particles.kind)
    assert np.all(kind[:1250] == Kind.FLUID)
    assert np.all(kind[1250:] != Kind.FLUID)


@pytest.mark.parametrize("ratio", [2.1, 2.4, 3.1, 4.0])
@pytest.mark.parametrize("depth", [None, 0.4])
def test_number_density_of_wetted_walls_is_complete(ratio, depth):
    case = hydrostatic(spacing=0.1, length=0.4, depth=depth, height=0.6, freeboard=0.0, ratio=ratio)
    position, kind = np.asarray(case.particles.position), np.asarray(case.particles.kind)
    reach = ratio * case.spacing
    i, j = cKDTree(position).query_pairs(reach, output_type="ndarray").T
    w = reach / np.linalg.norm(position[i] - position[j], axis=1) - 1.0
    n = np.bincount(i, w, len(kind)) + np.bincount(j, w, len(kind))
    wet = (kind <= Kind.WALL) & (position[:, -1] < 0.6 - reach + 0.5 * case.spacing)
    assert np.sum(wet & (kind == Kind.WALL)) > 0
    np.testing.assert_allclose(n[wet], lattice(ratio, case.dim).n0, rtol=1e-10)


@pytest.mark.parametrize("make", [dam_break, dam_break_3d, hydrostatic])
def test_all_particles_lie_in_the_box(make):
    case = make()
    assert np.all(np.asarray(case.box.contains(case.particles.position)))


def test_case_knows_its_parameters():
    case = dam_break(spacing=0.1, width=0.4)
    parameters = dict(case.parameters)
    assert case.name == "dam_break"
    assert parameters["spacing"] == 0.1
    assert parameters["width"] == 0.4
    assert parameters["tank_length"] == 2.0


def test_hydrostatic_pressure_grows_with_depth_and_vanishes_above_the_surface():
    found = hydrostatic_pressure(jnp.array([0.0, 0.3, 0.5, 0.6]), 0.5, 1200.0, 10.0)
    np.testing.assert_allclose(found, [6000.0, 2400.0, 0.0, 0.0], rtol=1e-13)


BAD = [0.0, -1.0, float("nan"), float("inf"), float("-inf"), "0.1", None, True, 1j, [0.1]]
LENGTHS = ("spacing", "width", "height", "tank_length", "tank_height")
MATERIAL = ("gravity", "density", "viscosity", "ratio")
ARGUMENTS = [
    *((dam_break, name) for name in (*LENGTHS, *MATERIAL)),
    *((dam_break_3d, name) for name in (*LENGTHS, "depth", *MATERIAL)),
    *((hydrostatic, name) for name in ("spacing", "length", "height", "depth", "freeboard", *MATERIAL)),
]


@pytest.mark.parametrize(("make", "name"), ARGUMENTS, ids=lambda x: getattr(x, "__name__", x))
def test_bad_argument_is_refused_by_name_and_value(unchecked, make, name):
    may_be_zero = name in ("gravity", "viscosity", "freeboard")
    for value in BAD:
        if (may_be_zero and value == 0.0) or (make is hydrostatic and name == "depth" and value is None):
            continue
        shown = f"{value:g}" if isinstance(value, float) else repr(value)
        with pytest.raises(ValueError) as caught:
            make(**{name: value})
        assert name in str(caught.value)
        assert shown in str(caught.value)


@pytest.mark.parametrize("make", [dam_break, dam_break_3d, hydrostatic])
def test_whole_numbers_are_lengths_too(unchecked, make):
    name = "length" if make is hydrostatic else "tank_length"
    assert counts(make(spacing=0.1, **{name: 2})) == counts(make(spacing=0.1, **{name: 2.0}))


@pytest.mark.parametrize(
    ("make", "arguments", "said"),
    [
        (dam_break, {"width": 2.5}, r"width must be at most tank_length \(2 m\), got 2.5 m"),
        (dam_break, {"height": 2.5}, r"height must be at most tank_height \(2 m\), got 2.5 m"),
        (dam_break, {"spacing": 0.6}, r"spacing must be at most width \(0.5 m\), got 0.6 m"),
        (dam_break, {"spacing": 0.1, "height": 0.05}, r"spacing must be at most height \(0.05 m\)"),
        (dam_break_3d, {"width": 1.5}, r"width must be at most tank_length \(1 m\), got 1.5 m"),
        (dam_break_3d, {"height": 0.7}, r"height must be at most tank_height \(0.5 m\), got 0.7 m"),
        (dam_break_3d, {"depth": 0.01}, r"spacing must be at most depth \(0.01 m\), got 0.02 m"),
        (hydrostatic, {"spacing": 0.5}, r"spacing must be at most length \(0.4 m\), got 0.5 m"),
    ],
)
def test_lengths_that_do_not_fit_are_refused_with_their_limit(make, arguments, said):
    with pytest.raises(ValueError, match=said):
        make(**arguments)


@pytest.mark.parametrize("make", [dam_break, dam_break_3d])
def test_column_may_fill_its_tank(make):
    case = make(spacing=0.1, width=0.6, tank_length=0.6, height=0.6, tank_height=0.6)
    assert counts(case)[0] == 6 * 6 * (1 if make is dam_break else 4)


def by_hand(**changes) -> Case:
    """Three particles in a box."""
    whole = {
        "position": jnp.array([[0.1, 0.1], [0.2, 0.1], [0.9, 0.9]]),
        "kind": jnp.array([0, 0, 1]),
        "phase": jnp.array([0, 0, 0]),
        "density": jnp.array([1000.0]),
        "viscosity": jnp.array([1e-6]),
        "gravity": jnp.array([0.0, -9.81]),
        "spacing": 0.1,
        "box": Box((0.0, 0.0), (1.0, 1.0)),
        "velocity": None,
        "pressure": None,
    }
    v = {**whole, **changes}
    particles = at_rest(v["position"], v["kind"], v["phase"])
    if v["velocity"] is not None:
        particles = eqx.tree_at(lambda p: p.velocity, particles, v["velocity"])
    if v["pressure"] is not None:
        particles = eqx.tree_at(lambda p: p.pressure, particles, v["pressure"])
    return Case(particles, Fluid(v["density"], v["viscosity"]), v["gravity"], v["spacing"], v["box"])


def test_case_by_hand_is_accepted():
    case = by_hand()
    assert case.dim == 2
    assert case.name == "custom"
    np.testing.assert_array_equal(case.density, 1000.0)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("value", [-0.1, 1.0, 1.5, float("nan"), float("inf")])
def test_particle_outside_of_the_box_is_named(axis, value):
    place = by_hand().particles.position.at[1, axis].set(value)
    with pytest.raises(ValueError, match=r"every particle must lie in the box.*particle 1 at"):
        by_hand(position=place)


def test_removed_particles_may_lie_anywhere():
    place = by_hand().particles.position.at[1, 0].set(-5.0)
    assert by_hand(position=place, kind=jnp.array([0, 3, 1])).dim == 2


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan")])
def test_density_that_is_not_positive_is_refused(value):
    with pytest.raises(ValueError, match=r"fluids.density must be greater than zero"):
        by_hand(density=jnp.array([1000.0, value]), viscosity=jnp.zeros(2))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"position": jnp.zeros((3, 3)) + 0.5}, r"particles.position must have the shape.*\(3, 3\)"),
        ({"gravity": jnp.array([0.0, 0.0, -9.81])}, r"gravity must have 2 components, got \(3,\)"),
        ({"viscosity": jnp.zeros(2)}, r"one entry for each phase, got \(1,\) and \(2,\)"),
        ({"phase": jnp.array([0, 1, 0])}, r"particles.phase must be between 0 and 0, got 1 for particle 1"),
        ({"phase": jnp.array([0, -1, 0])}, r"particles.phase must be between 0 and 0, got -1 for particle 1"),
        ({"velocity": jnp.zeros((2, 2))}, r"velocity.*\(2, 2\)"),
        ({"pressure": jnp.zeros(4)}, r"pressure.*\(4,\)"),
        ({"viscosity": jnp.array([-1e-6])}, r"fluids.viscosity must be zero or greater, got -1e-06 m\^2/s in entry 0"),
        ({"viscosity": jnp.array([jnp.inf])}, r"fluids.viscosity must be zero or greater, got inf m\^2/s"),
        ({"density": jnp.array([jnp.inf])}, r"fluids.density must be greater than zero, got inf kg/m\^3"),
        ({"gravity": jnp.array([0.0, jnp.nan])}, r"gravity must be finite, got nan m/s\^2 in entry 1"),
        ({"velocity": jnp.zeros((3, 2)).at[2, 1].set(jnp.nan)}, r"velocity must be finite, got nan m/s for particle 2"),
        ({"pressure": jnp.zeros(3).at[1].set(jnp.inf)}, r"pressure must be finite, got inf Pa for particle 1"),
        ({"kind": jnp.array([0, 4, 1])}, r"kind must be one of 0 \(fluid\), .*3 \(removed\), got 4 for particle 1"),
        ({"kind": jnp.array([0, -1, 1])}, r"particles.kind must be one of 0 \(fluid\), .* got -1 for particle 1"),
        ({"velocity": jnp.zeros((3, 2), int)}, r"velocity must be floating-point numbers, got int"),
        ({"position": jnp.zeros((0, 2)), "kind": jnp.zeros(0, int), "phase": 0}, r"must be one at least, got none"),
        ({"spacing": 0.0}, r"spacing must be greater than zero, got 0 m"),
        ({"spacing": float("nan")}, r"spacing must be a finite number in m, got nan m"),
    ],
)
def test_wrong_shapes_and_values_are_refused_by_name_and_value(unchecked, changes, said):
    with pytest.raises(ValueError, match=said):
        by_hand(**changes)


def test_case_can_be_made_under_jit():
    spacing = jax.jit(lambda x: by_hand(gravity=x).gravity[1])(jnp.array([0.0, -1.0]))
    assert float(spacing) == -1.0


def test_jitter_is_reproducible_with_its_key():
    case = dam_break(spacing=0.1)
    first, again, other = (jitter(case, 0.2, jax.random.key(k)).particles.position for k in (3, 3, 4))
    np.testing.assert_array_equal(first, again)
    assert np.any(np.asarray(first) != np.asarray(other))


@pytest.mark.parametrize("amplitude", [0.05, 0.3])
def test_jitter_moves_each_fluid_particle_by_up_to_its_amplitude_and_nothing_else(amplitude):
    case = dam_break(spacing=0.05)
    moved = jitter(case, amplitude, jax.random.key(0))
    shift = np.asarray(moved.particles.position - case.particles.position) / case.spacing
    fluid = np.asarray(case.particles.fluid)
    np.testing.assert_array_equal(shift[~fluid], 0.0)
    assert np.all(shift[fluid] != 0.0)
    assert np.abs(shift).max() <= amplitude * (1 + 1e-12)
    # Uniform: the largest of 400 draws comes close to the amplitude, their mean to zero.
    assert np.abs(shift).max() > 0.95 * amplitude
    assert np.abs(shift[fluid].mean(axis=0)).max() < 4 * amplitude / np.sqrt(3 * fluid.sum())


def test_jitter_of_zero_changes_nothing():
    case = dam_break(spacing=0.1)
    moved = jitter(case, 0.0, jax.random.key(0))
    np.testing.assert_array_equal(moved.particles.position, case.particles.position)


@pytest.mark.parametrize("amplitude", [-0.1, 0.31, float("nan"), float("inf"), "0.1"])
def test_jitter_refuses_amplitudes_out_of_its_range(unchecked, amplitude):
    with pytest.raises(ValueError, match="amplitude must be"):
        jitter(dam_break(spacing=0.1), amplitude, jax.random.key(0))


def test_cases_are_at_hand_in_the_package():
    assert jaxmps.cases.dam_break is cases.dam_break is dam_break
    assert isinstance(dam_break(spacing=0.1).particles, Particles)


@pytest.mark.parametrize("spacing", [1e-5, 1e-12, 1e-300])
def test_a_spacing_that_leaves_more_particles_than_can_be_is_refused(spacing):
    for case in (cases.hydrostatic, cases.dam_break, cases.standing_wave, cases.square_patch):
        with pytest.raises(ValueError, match="spacing must leave at most"):
            case(spacing=spacing)
