import pytest
from matplotlib.figure import Figure


@pytest.fixture
def figures(monkeypatch):
    """Returns the figures that are saved during a test, none of which is rendered."""
    saved = []
    monkeypatch.setattr(
        Figure, "savefig", lambda self, path, **_: (saved.append(self), path.touch())
    )
    return saved
