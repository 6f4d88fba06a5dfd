"""Messages: parsed by type, or rejected with the rule, the allowed values and the given one."""

from __future__ import annotations

from typing import Any

import pytest

from clvol.base.errors import OptionError
from clvol.view.panes import PaneSize
from clvol.view.protocol import Change, PointerOrKey, Request, Resize, parse


def test_each_type_is_parsed() -> None:
    assert parse({"type": "event", "event": {"event_type": "wheel"}}) == PointerOrKey({"event_type": "wheel"})
    resize = {"event_type": "resize", "pane": "x", "width": 4, "height": 1e5, "pixel_ratio": 9}
    assert parse({"type": "event", "event": resize}) == Resize("x", PaneSize(16, 8192, 4))
    change = parse({"type": "set", "changes": {"step": 1, "mode": "mip"}, "live": 1, "number": 3, "gesture": 7})
    assert change == Change({"step": 1, "mode": "mip"}, whole=False, live=True, gesture=None, number=3)
    assert change.step == ("set", "mode", "step")
    assert Change({}, whole=False, live=False, gesture="drag 3", number=None).step == ("set", "drag 3")
    assert Change({}, whole=False, live=False, gesture=None, number=None).step is None
    request = parse({"type": "do", "what": "pick", "id": 4, "x": 1, "y": 2})
    assert isinstance(request, Request)
    assert (request.what, request.id, request.pane("z"), request.position()) == ("pick", 4, "z", (1, 2))
    assert request.size((30, 20), 1, 100) == (30, 20)


@pytest.mark.parametrize(
    ("message", "says"),
    [
        ([], "a message must be an object of JSON"),
        ({"type": "nonsense"}, "the type of a message must be one of event, set, do, hover, ack; got 'nonsense'"),
        ({"type": "event", "event": {"type": "resize", "pane": "w"}}, "pane must be one of"),
        ({"type": "event", "event": {"type": "resize", "width": "a", "height": 1}}, "width must be"),
        ({"type": "event", "event": {"type": "resize", "width": 1, "height": 1, "ratio": 0}}, "ratio must be"),
    ],
)
def test_invalid_messages_are_rejected(message: Any, says: str) -> None:
    with pytest.raises(OptionError, match=says):
        parse(message)


def test_arguments_of_requests_are_checked_as_they_are_used() -> None:
    request = parse({"type": "do", "what": "save_picture", "pane": "w", "width": 0, "x": "far"})
    assert isinstance(request, Request)
    for use in (lambda: request.pane("3d"), lambda: request.size((1, 1), 1, 9), request.position):
        with pytest.raises(OptionError):
            use()
