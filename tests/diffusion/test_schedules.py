import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sg3d_jax.diffusion.schedules import cosine, strided_times


@pytest.mark.parametrize("num_steps", [1, 10, 500])
def test_cosine__is_its_closed_form(num_steps):
    def f(time):
        return math.cos(math.pi / 2 * (time / num_steps + 0.008) / 1.008) ** 2

    expected = [f(time) / f(0) for time in range(num_steps + 1)]
    np.testing.assert_allclose(cosine(num_steps), expected, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("exponent", [1.5, 2.5])
def test_cosine__of_a_larger_exponent_is_that_of_an_earlier_time(exponent):
    plain, later = np.asarray(cosine(10_000), np.float64), np.asarray(cosine(100, exponent))
    time = 10_000 * (np.arange(101) / 100) ** exponent
    np.testing.assert_allclose(later, np.interp(time, np.arange(10_001), plain), atol=1e-6)


def test_cosine__falls_from_one_to_nothing():
    signal = np.asarray(cosine(500))
    assert signal[0] == 1
    assert 0 <= signal[-1] < 1e-6
    assert (np.diff(signal) < 0).all()


@given(st.integers(1, 600), st.data())
@settings(deadline=None, max_examples=20)
def test_strided_times__fall_without_repeats_from_the_last_to_zero(num_steps, data):
    num_samples = data.draw(st.integers(1, num_steps))
    times = np.asarray(strided_times(num_steps, num_samples))
    assert times.shape == (num_samples + 1,)
    assert times[0] == num_steps
    assert times[-1] == 0
    strides = -np.diff(times)
    assert strides.min() >= 1
    assert strides.max() - strides.min() <= 2


def test_strided_times__visit_every_time_if_as_many_are_wanted():
    np.testing.assert_array_equal(strided_times(7, 7), range(7, -1, -1))


@pytest.mark.parametrize("num_samples", [-1, 0, 8])
def test_strided_times__refuse_more_steps_than_there_are_and_less_than_one(num_samples):
    with pytest.raises(ValueError, match=rf"must be in 1\.\.7, got {num_samples}"):
        strided_times(7, num_samples)
