"""Fixtures of the viewer's tests."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from clvol import Volume
from clvol.device import Device
from clvol.view import View
from tests.view.browser import browser
from tests.view.clients import Client, at_rest

__all__ = ["browser", "client"]


@pytest.fixture(scope="module")
def view(volume: Volume, device: Device) -> Iterator[View]:
    """Of the test module's volume."""
    made = View(volume, device=device)
    yield made
    made.close()


@pytest.fixture
def client(view: View, request: pytest.FixtureRequest) -> Iterator[Client]:
    """Of the test module's view; where the module says `AT_REST`, the size of a pane, with its still picture."""
    size = getattr(request.module, "AT_REST", None)
    if size is not None:
        with at_rest(view, size) as made:
            yield made
        return
    made = Client(view)
    yield made
    made.close()
