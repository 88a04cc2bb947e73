"""Sensitivities from responses: many plants with one controller, against numpy's inverses."""

import numpy as np
import pytest

from platform_ctrl.analysis.feedback import sensitivities_of_plants, sensitivity_functions


def responses(*shape, seed=0):
    real, imaginary = np.random.default_rng(seed).normal(size=(2, *shape))
    return real + 1j * imaginary


@pytest.mark.parametrize(("p", "m"), [(1, 1), (2, 2), (3, 3), (2, 3), (4, 2)])
def test_one_inverse_serves_output_and_input(p, m):
    P, K = responses(5, 7, p, m), responses(7, m, p, seed=1)
    S_output, S_input = sensitivities_of_plants(P, K)
    np.testing.assert_allclose(S_output, np.linalg.inv(np.eye(p) - P @ K), rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(S_input, np.linalg.inv(np.eye(m) - K @ P), rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("m", [1, 2, 3, 6])
def test_sensitivity_and_its_complement_are_one_together(m):
    L = responses(4, 5, m, m)
    S, T = sensitivity_functions(L)
    np.testing.assert_allclose(S @ (np.eye(m) + L), np.broadcast_to(np.eye(m), S.shape), atol=1e-10)
    np.testing.assert_allclose(S + T, np.broadcast_to(np.eye(m), S.shape), atol=1e-12)


def test_a_loop_through_minus_one_has_no_sensitivity_and_leaves_the_others_alone():
    L = np.array([[[-1.0]], [[1.0]], [[np.nan]]], dtype=complex)
    assert sensitivity_functions(L)[0][:, 0, 0].tolist() == [np.inf, 0.5, np.inf]
    P, K = np.ones((1, 2, 1, 1), dtype=complex), np.array([[[1.0]], [[-1.0]]], dtype=complex)
    for found in sensitivities_of_plants(P, K):
        assert found[0, :, 0, 0].tolist() == [np.inf, 0.5]
