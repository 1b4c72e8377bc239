import pytest

from tests.unchecked import unchecked


@pytest.fixture
def _unchecked():
    """A pickle has a call for every word."""
    with unchecked():
        yield
