"""Fixtures of the viewer's tests."""

from __future__ import annotations

from tests.view.browser import browser

__all__ = ["browser"]
