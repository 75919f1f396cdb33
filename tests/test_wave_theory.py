"""The theory of the standing wave: each order against the equations that it comes from."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmps.cases import (
    standing_wave_frequency,
    standing_wave_linear,
    standing_wave_reference,
    standing_wave_second_order,
    standing_wave_wu_taylor,
)

FORMS = [standing_wave_linear, standing_wave_second_order, standing_wave_wu_taylor]
GRAVITY = 9.81
K = 2.0 * np.pi  # wavenumber of a wave of 1 m
POINTS = np.arange(32) / 32.0  # of which the 17th is the center


def spectral(depth: float, amplitude: float, steps: int = 400) -> tuple[np.ndarray, np.ndarray]:
    """Times over two periods, and the elevation at POINTS, by the equations of the surface up to quadratic terms.

    With ψ the potential at the surface and G = |k| tanh |k|h (Zakharov 1968; Craig & Sulem 1993):
    η_t = Gψ − (ηψ_x)_x − G(ηGψ),  ψ_t = −gη − ψ_x²/2 + (Gψ)²/2.
    In Fourier modes, without the highest third of them, and by the classical Runge–Kutta method.
    """
    wavenumber = K * np.arange(len(POINTS) // 2 + 1)
    kept = np.arange(len(wavenumber)) < len(POINTS) / 3
    operator, slope = kept * wavenumber * np.tanh(wavenumber * depth), kept * 1j * wavenumber

    def apply(factor, values):
        return np.fft.irfft(factor * np.fft.rfft(values), len(POINTS))

    def rate(state):
        eta, psi = state
        along, up = apply(slope, psi), apply(operator, psi)
        surface = up - apply(slope, eta * along) - apply(operator, eta * up)
        return np.stack([surface, -GRAVITY * eta + apply(kept, 0.5 * (up**2 - along**2))])

    step = 2.0 * 2.0 * np.pi / np.sqrt(GRAVITY * K * np.tanh(K * depth)) / steps
    states = [np.stack([-amplitude * np.cos(K * POINTS), np.zeros_like(POINTS)])]
    for _ in range(steps):
        first = rate(states[-1])
        second = rate(states[-1] + 0.5 * step * first)
        third = rate(states[-1] + 0.5 * step * second)
        fourth = rate(states[-1] + step * third)
        states.append(states[-1] + step / 6.0 * (first + 2.0 * second + 2.0 * third + fourth))
    return step * np.arange(steps + 1), np.stack(states)[:, 0]


def crests(time: np.ndarray, elevation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    top = 1 + np.flatnonzero((elevation[1:-1] > elevation[:-2]) & (elevation[1:-1] > elevation[2:]))
    return time[top], elevation[top]


def test_linear_wave_swings_between_crest_and_trough():
    period = 2.0 * np.pi / standing_wave_frequency()
    quarters = standing_wave_linear(0.25 * period * np.arange(5))
    np.testing.assert_allclose(quarters, [0.07, 0.0, -0.07, 0.0, 0.07], atol=1e-15)
    swing = standing_wave_linear(0.5 * period * np.arange(2)[:, None], 2.0, position=np.array([0.0, 0.5, 1.0, 2.0]))
    assert swing.shape == (2, 4)
    np.testing.assert_allclose(swing[0], [-0.07, 0.0, 0.07, -0.07], atol=1e-15)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("depth", [0.1, 1.0 / 3.0, 5.0])
def test_wave_starts_at_rest_with_the_amplitude_at_the_center(form, depth):
    assert form(0.0, 1.0, depth) == pytest.approx(0.07, rel=1e-14)
    assert jax.grad(form)(0.0, 1.0, depth) == pytest.approx(0.0, abs=1e-14)
    # And it falls: with −Aω² in linear theory.
    assert jax.grad(jax.grad(form))(0.0, 1.0, depth) < 0.0


def test_surface_of_second_order_starts_as_a_cosine_and_at_rest_everywhere():
    x = jnp.asarray(POINTS)
    start, velocity = jax.jvp(lambda t: standing_wave_second_order(t, position=x), (0.0,), (1.0,))
    np.testing.assert_allclose(start, -0.07 * np.cos(K * POINTS), atol=1e-15)
    np.testing.assert_allclose(velocity, 0.0, atol=1e-14)


def test_water_is_conserved_and_the_surface_symmetric():
    time = np.linspace(0.0, 3.0, 40)[:, None]
    surface = np.asarray(standing_wave_second_order(time, position=POINTS))
    assert surface.shape == (40, 32)
    np.testing.assert_allclose(surface.mean(axis=1), 0.0, atol=1e-16)
    np.testing.assert_allclose(surface[:, 1:], surface[:, :0:-1], atol=1e-15)
    np.testing.assert_allclose(surface[:, 16], standing_wave_second_order(time[:, 0]), atol=1e-15)


def test_forms_of_second_order_agree_in_deep_water():
    time = np.linspace(0.0, 5.0, 500)
    depth = 30.0 / K
    exact = standing_wave_second_order(time, 1.0, depth)
    np.testing.assert_allclose(standing_wave_wu_taylor(time, 1.0, depth), exact, atol=1e-15)
    omega = np.sqrt(GRAVITY * K)
    closed = 1.0 + np.cos(2.0 * omega * time) - 2.0 * np.cos(np.sqrt(2.0) * omega * time)
    np.testing.assert_allclose(exact, 0.07 * np.cos(omega * time) + K * 0.07**2 / 4.0 * closed, atol=1e-14)


@pytest.mark.parametrize("kh", [0.94, 2.0 * np.pi / 3.0, 6.28])
def test_error_of_second_order_falls_with_the_third_power_of_the_amplitude_at_any_depth(kh):
    error = []
    for amplitude in (0.001, 0.0005):
        time, eta = spectral(kh / K, amplitude)
        theory = standing_wave_second_order(time[:, None], 1.0, kh / K, amplitude, position=POINTS)
        error.append(np.abs(eta - theory).max())
    assert error[0] / error[1] == pytest.approx(8.0, rel=0.02)
    # It is a small part of what the second order adds, which is about kA² or more.
    assert error[0] < 0.04 * K * 0.001**2


@pytest.mark.parametrize("form", [standing_wave_linear, standing_wave_wu_taylor])
def test_error_of_the_others_falls_with_the_second_power_at_finite_depth(form):
    error = []
    for amplitude in (0.0004, 0.0002):
        time, eta = spectral(1.0 / 3.0, amplitude)
        error.append(np.abs(eta[:, 16] - form(time, 1.0, 1.0 / 3.0, amplitude)).max())
    assert error[0] / error[1] == pytest.approx(4.0, rel=0.03)


def test_error_of_wu_and_taylor_is_half_the_square_of_the_amplitude_for_the_case_of_the_paper():
    time, eta = spectral(1.0 / 3.0, 0.0002)
    error = np.abs(eta[:, 16] - standing_wave_wu_taylor(time, 1.0, 1.0 / 3.0, 0.0002)).max()
    assert error == pytest.approx(0.5 * 0.0002**2, rel=0.05)


@pytest.mark.parametrize("depth", [0.15, 1.0 / 3.0, 1.0])
def test_second_order_is_the_same_by_the_amplitude_of_its_potential(depth):
    # φ₂ has the part P sin 2ωt cos 2θ; η₂ then follows from the dynamic condition.
    time, a, g = np.linspace(0.0, 4.0, 401), 0.07, GRAVITY
    omega = np.sqrt(g * K * np.tanh(K * depth))
    free = np.sqrt(2.0 * g * K * np.tanh(2.0 * K * depth))
    p = 0.75 * a**2 / omega * ((g * K) ** 2 - omega**4) / (free**2 - 4.0 * omega**2)
    second = -(
        2.0 * omega * p * np.cos(2.0 * omega * time)
        + (0.5 * (a * omega) ** 2 - 2.0 * omega * p) * np.cos(free * time)
        - 0.25 * (a * omega) ** 2 * (1.0 + np.cos(2.0 * omega * time))
        + a**2 / (8.0 * omega**2) * (1.0 - np.cos(2.0 * omega * time)) * (omega**4 - (g * K) ** 2)
    )
    expected = a * np.cos(omega * time) + second / g
    np.testing.assert_allclose(standing_wave_second_order(time, 1.0, depth), expected, atol=1e-13)


def test_wu_and_taylor_has_its_known_crests():
    time, height = crests(t := np.linspace(0.0, 2.8, 28001), np.asarray(standing_wave_wu_taylor(t)))
    np.testing.assert_allclose(time, [0.821, 1.600, 2.461], atol=6e-4)
    np.testing.assert_allclose(height, [0.0994, 0.0763, 0.0923], atol=6e-5)


def test_second_order_is_nearer_to_the_nonlinear_wave_than_linear_theory():
    time, center, sides = standing_wave_reference().T
    early = time < 0.9
    for x, reference in [(0.5, center), (0.0, sides)]:
        linear, second = (
            np.abs(form(time, position=x) - reference)[early].mean()
            for form in (standing_wave_linear, standing_wave_second_order)
        )
        assert second < 0.7 * linear


@pytest.mark.parametrize("form", FORMS)
def test_derivatives_in_all_arguments_are_those_of_finite_differences(form):
    arguments = (0.7, 1.1, 0.3, 0.05, 9.5)
    derivatives = jax.jit(jax.grad(form, argnums=range(5)))(*arguments)
    for i, derivative in enumerate(derivatives):
        above, below = ([*arguments[:i], arguments[i] + d, *arguments[i + 1 :]] for d in (1e-6, -1e-6))
        assert derivative == pytest.approx(float(form(*above) - form(*below)) / 2e-6, rel=1e-6)


@pytest.mark.parametrize("precision", ["single"], indirect=True)
@pytest.mark.parametrize("form", FORMS)
def test_single_precision_is_enough(precision, form):
    time = np.linspace(0.0, 3.0, 50)
    single = form(time)
    assert single.dtype == jnp.float32
    with jax.enable_x64(True):
        double = np.asarray(form(time))
    np.testing.assert_allclose(single, double, atol=1e-6)
