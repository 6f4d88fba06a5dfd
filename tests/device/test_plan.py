"""Idle plans are given to the next call of their kind, until they are too many or too large together."""

from __future__ import annotations

from clvol.device.plan import Plans


def test_a_plan_serves_the_next_call_of_its_kind() -> None:
    plans: Plans[str] = Plans()
    plans.give("a", "one", 1 << 20)
    assert plans.take("a", lambda: "new") == "one"
    assert plans.take("a", lambda: "new") == "new"


def test_idle_plans_hold_at_most_64_mib() -> None:
    plans: Plans[str] = Plans()
    for number in range(5):  # 80 MiB
        plans.give(number, "old", 1 << 24)
    assert [plans.take(number, lambda: "new") for number in range(5)] == ["new"] * 4 + ["old"]
