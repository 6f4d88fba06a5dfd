"""Available memory: it is checked before it is allocated, and every limit counts."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from clvol.base import memory
from clvol.base.errors import OutOfMemoryError

MIB = 1 << 20
linux = pytest.mark.skipif(sys.platform in ("win32", "darwin"), reason="limits are read from /proc and /sys")


def put(root: Path, files: dict[str, str]) -> Path:
    for name, text in files.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return root


def machine(root: Path, available: int = 8192, swap: int = 0) -> Path:
    return put(root, {"proc/meminfo": f"MemTotal: 99999999 kB\nMemAvailable: {available * 1024} kB\nSwapFree: {swap * 1024} kB\n"})


def second(root: Path, group: str, mounted: str = "/") -> Path:
    return put(
        root,
        {
            "proc/self/cgroup": f"1:name=systemd:/x\n0::{group}\n",
            "proc/self/mountinfo": f"30 23 0:28 {mounted} /sys/fs/cgroup rw,relatime shared:9 - cgroup2 cgroup2 rw,nsdelegate\n",
        },
    )


def limited(root: Path, group: str, most: object, used: int, cached: int = 0) -> None:
    stat = f"anon 1\nactive_file {cached // 2 * MIB}\ninactive_file {(cached - cached // 2) * MIB}\n"
    at = f"sys/fs/cgroup/{group}"
    put(root, {f"{at}/memory.max": f"{most}\n", f"{at}/memory.current": f"{used * MIB}\n", f"{at}/memory.stat": stat})


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(memory, "ROOT", tmp_path)
    return machine(tmp_path)


@linux
def test_the_machine_is_a_limit(root: Path) -> None:
    assert memory.room() == (8192 * MIB, "all of the machine's")
    machine(root, available=1000, swap=24)
    assert memory.available() == 1024 * MIB


@linux
def test_a_limit_of_control_groups_2_counts(root: Path) -> None:
    second(root, "/kube/pod/box")
    limited(root, "kube/pod/box", 2048 * MIB, used=1500, cached=500)
    assert memory.room() == (1048 * MIB, "the container's limit is 2048 MiB")


@linux
def test_the_limit_of_each_ancestor_group_counts(root: Path) -> None:
    second(root, "/kube/pod/box")
    limited(root, "kube/pod/box", "max", used=100)
    limited(root, "kube/pod", 900 * MIB, used=700)
    limited(root, "kube", 4096 * MIB, used=700)
    assert memory.available() == 200 * MIB


@linux
@pytest.mark.parametrize("mounted", ["/kube/box", "/elsewhere"])
def test_in_a_container_its_group_is_the_root(root: Path, mounted: str) -> None:
    second(root, "/kube/box", mounted)
    limited(root, "", 512 * MIB, used=12)
    assert memory.available() == 500 * MIB


@linux
def test_a_limit_of_control_groups_1_counts(root: Path) -> None:
    at = "sys/fs/cgroup/memory"
    put(
        root,
        {
            "proc/self/cgroup": "9:name=systemd:/\n4:hugetlb,memory:/docker/1f\n0::/\n",
            "proc/self/mountinfo": (
                "33 31 0:30 / /sys/fs/cgroup/cpu rw - cgroup cgroup rw,cpu\n"
                "34 31 0:31 /docker/1f /sys/fs/cgroup/memory rw - cgroup cgroup rw,hugetlb,memory\n"
                "41 31 0:38 / /sys/fs/cgroup/unified rw - cgroup2 cgroup2 rw\n"
            ),
            f"{at}/memory.limit_in_bytes": f"{3000 * MIB}\n",
            f"{at}/memory.usage_in_bytes": f"{2600 * MIB}\n",
            f"{at}/memory.stat": f"inactive_file 1\ntotal_active_file 0\ntotal_inactive_file {100 * MIB}\n",
        },
    )
    assert memory.available() == 500 * MIB


@linux
def test_without_a_limit_the_machine_counts(root: Path) -> None:
    put(root, {"proc/self/cgroup": "4:memory:/a\n", "proc/self/mountinfo": "1 0 0:1 / /sys/fs/cgroup rw - tmpfs tmpfs rw\ncut\n"})
    assert memory.available() == 8192 * MIB
    second(root, "/a")
    limited(root, "a", "max", used=1)
    assert memory.available() == 8192 * MIB


@linux
def test_a_group_over_its_limit_has_no_memory(root: Path) -> None:
    second(root, "/a")
    limited(root, "a", 100 * MIB, used=130)
    assert memory.available() == 0
    with pytest.raises(OutOfMemoryError, match="a result must fit into the 0 MiB that are available"):
        memory.require(100 * MIB, "a result")


@linux
def test_the_message_states_needed_and_available_memory(root: Path) -> None:
    second(root, "/a")
    limited(root, "a", 1000 * MIB, used=0)
    memory.require(900 * MIB, "a result")
    with pytest.raises(OutOfMemoryError) as told:
        memory.require(2000 * MIB, "a result")
    assert str(told.value) == (
        "out of memory: a result must fit into the 968 MiB that are available (the container's limit is 1000 MiB); got 2000 MiB"
    )
    assert isinstance(told.value, MemoryError)


@linux
def test_freed_memory_is_available_again(root: Path) -> None:
    machine(root, available=1000)
    for _ in range(5):  # an answer is cached, less the memory granted; before an error it is measured again
        memory.require(900 * MIB, "a result")


@linux
def test_small_requests_are_not_checked(root: Path) -> None:
    machine(root, available=0)
    memory.require(1000, "a result")


@linux
def test_the_limits_of_ulimit_count() -> None:
    limit = "import resource; resource.setrlimit(resource.RLIMIT_{}, (2 << 30,) * 2); "
    code = limit + "from clvol.base import memory; print(*memory.room())"
    for kind, name in (("AS", "ulimit -v"), ("DATA", "ulimit -d")):
        done = subprocess.run(
            [sys.executable, "-c", code.format(kind)],
            capture_output=True,
            encoding="utf-8",
            timeout=60,
            check=True,
            env={**os.environ},
        )
        nbytes, said = done.stdout.split(maxsplit=1)
        assert 0 < int(nbytes) < 2048 * MIB
        assert said.strip() == f"{name} is 2048 MiB"


def test_this_machine_has_memory() -> None:
    assert 0 < memory.available() <= sys.maxsize


def test_axes_too_long_for_kernels_are_rejected() -> None:
    memory.require_addressable("data", ((1 << 31) - 1, 1))
    with pytest.raises(OutOfMemoryError, match="2147483647 samples along each axis"):
        memory.require_addressable("data", (1, 1 << 31))


@linux
def test_unwritten_results_count(root: Path) -> None:
    machine(root, available=1000)
    result = memory.empty((400, MIB), "u1", "a result")
    with pytest.raises(OutOfMemoryError):
        memory.require(700 * MIB, "coefficients")
    memory.require(500 * MIB, "coefficients")
    del result
    memory.require(700 * MIB, "coefficients")
