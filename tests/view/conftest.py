"""Fixtures of the viewer's tests."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from clvol.view import View
from tests.view.browser import browser
from tests.view.clients import Client

__all__ = ["browser", "client"]


@pytest.fixture
def client(view: View) -> Iterator[Client]:
    """Of the test module's view."""
    made = Client(view)
    yield made
    made.close()
