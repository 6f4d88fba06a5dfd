"""Set-up with pip alone: Intel's runtime is found where pip installs it and registered with the loader; doctor reports it."""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

import clvol
from clvol.cli import _doctor as doctor
from clvol.device import Device, as_device, choose, devices
from clvol.device.runtimes import intel

VENDORS = ("OCL_ICD_VENDORS", "OPENCL_VENDOR_PATH", "OCL_ICD_FILENAMES", "CL_CONFIG_USE_VECTORIZER", "CL_CONFIG_TBB_DLL_PATH")


@pytest.fixture
def runtime(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Intel's runtime, laid out as by its wheel, with empty files; no loader variable set."""
    name = "Library/bin/intelocl64.dll" if sys.platform == "win32" else "lib/libintelocl.so"
    packages = tmp_path / "env/lib/python3/site-packages"
    about = packages / "intel_opencl_rt-2026.2.0.dist-info"
    about.mkdir(parents=True)
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: intel-opencl-rt\nVersion: 2026.2.0\n")
    (about / "RECORD").write_text(f"../../../lib/libintelocl_emu.so,,\n../../../{name},,\n")
    library = tmp_path / "env" / name
    library.parent.mkdir(parents=True, exist_ok=True)
    library.touch()
    monkeypatch.syspath_prepend(packages)
    monkeypatch.setattr(sys, "prefix", str(tmp_path / "env"))
    for variable in VENDORS:
        monkeypatch.setenv(variable, "")  # so that the code's changes are undone after the test
        monkeypatch.delenv(variable)
    return library.resolve()


def seen() -> list[str]:
    """The contents of a loader's folder."""
    return [file.read_text().strip() for file in sorted(Path(os.environ["OCL_ICD_VENDORS"]).glob("*.icd"))]


def vendors(folder: Path, **texts: str) -> Path:
    folder.mkdir(parents=True)
    for name, text in texts.items():
        (folder / f"{name}.icd").write_text(text)
    return folder


linux = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="how Linux's loaders look for vendors")


@linux
def test_the_loader_finds_intels_runtime_beside_others(runtime: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert intel.library() == runtime
    (tmp_path / "gpu.so").touch()
    # in the environment lies what Intel's wheel brings, which names a folder that is not here
    vendors(tmp_path / "env/etc/OpenCL/vendors", cpu="/opt/nowhere/lib/libintelocl.so\n")
    given = vendors(tmp_path / "given", b=f"{tmp_path}/gpu.so\n", a="libnvidia-opencl.so.1", gone="/opt/nowhere/lib/libgone.so")
    (given / "link.icd").symlink_to(tmp_path / "nowhere")
    for folder, others in ((None, []), (given, ["libnvidia-opencl.so.1", f"{tmp_path}/gpu.so"])):
        if folder:
            monkeypatch.setenv("OCL_ICD_VENDORS", str(folder))
        with intel.known_to_the_loader():
            own = Path(os.environ["OCL_ICD_VENDORS"])
            found = seen()
        assert found[-1] == str(runtime)
        assert folder is None or found[:-1] == others  # else what this system has
        assert not any("nowhere" in text for text in found)
        assert not own.exists()
        assert os.environ.get("OCL_ICD_VENDORS") == (str(folder) if folder else None)
    assert os.environ["CL_CONFIG_USE_VECTORIZER"] == "False"


@linux
def test_variables_set_by_the_user_are_kept(runtime: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CL_CONFIG_USE_VECTORIZER", "True")
    other = tmp_path / "oneapi/libintelocl.so"
    other.parent.mkdir()
    other.touch()
    one_of_intels = vendors(tmp_path / "given", intel=str(other))
    for value in (os.devnull, str(runtime), str(one_of_intels)):
        monkeypatch.setenv("OCL_ICD_VENDORS", value)
        with intel.known_to_the_loader():
            assert os.environ["OCL_ICD_VENDORS"] == value
    assert os.environ["CL_CONFIG_USE_VECTORIZER"] == "True"


def test_on_windows_the_loader_gets_the_file(runtime: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "win32")
    monkeypatch.setenv("PATH", "before")
    monkeypatch.setenv("OCL_ICD_FILENAMES", "other.dll")
    for _ in range(2):
        with intel.known_to_the_loader():
            assert os.environ["OCL_ICD_FILENAMES"] == os.pathsep.join([str(runtime), "other.dll"])
    assert os.environ["OCL_ICD_FILENAMES"] == "other.dll"
    assert os.environ["PATH"] == os.pathsep.join(["before", str(runtime.parent)])  # for what it loads later, by name
    assert os.environ["CL_CONFIG_TBB_DLL_PATH"] == str(runtime.parent)


def test_nothing_changes_without_intels_runtime(runtime: Path) -> None:
    before = dict(os.environ)
    runtime.unlink()
    assert intel.library() is None
    with intel.known_to_the_loader():
        assert dict(os.environ) == before


def test_pocl_is_first_where_it_links_and_last_where_it_does_not(monkeypatch: pytest.MonkeyPatch) -> None:
    class Fake:
        available = compiler_available = True

        def __init__(self, kind: int, name: str) -> None:
            self.type, self.platform, self.name, self.int_ptr = kind, self, name, id(self)

        def get_devices(self) -> list[Fake]:
            return [self]

    import pyopencl as cl

    kinds = cl.device_type
    fakes = [
        Fake(kinds.CPU, "Intel(R) OpenCL"),
        Fake(kinds.CPU, "Portable Computing Language"),
        Fake(kinds.GPU, "NVIDIA CUDA"),
        Fake(kinds.CPU, "Another"),
    ]
    monkeypatch.setattr(cl, "get_platforms", lambda: fakes)
    monkeypatch.setattr(choose, "_devices", {})
    monkeypatch.delenv("CLVOL_DEVICE", raising=False)
    monkeypatch.setattr(choose, "_warn_of_change", lambda _: None)
    monkeypatch.setattr(Device, "fault", "")
    assert [d.name[:3] for d in devices()] == ["NVI", "Por", "Int", "Ano"]
    assert doctor._used() == "NVIDIA CUDA (NVIDIA CUDA): GPUs come first"
    del fakes[2]
    assert "it can link its kernels here" in doctor._used()
    monkeypatch.setattr(Device, "fault", property(lambda self: "PoCL needs the linker 'ld'" if self.is_pocl else ""))
    assert [d.name[:3] for d in devices()] == ["Int", "Ano", "Por"]
    assert doctor._used() == "Intel(R) OpenCL (Intel(R) OpenCL): PoCL needs the linker 'ld'"
    monkeypatch.setenv("CLVOL_DEVICE", "portable")
    assert doctor._used().endswith("CLVOL_DEVICE is portable")


def test_without_a_linker_doctor_says_what_to_install(tmp_path: Path, device: Device) -> None:
    """PATH contains Python alone, and the home is empty: PoCL cannot link, and doctor names an alternative."""
    try:
        (tmp_path / "python").symlink_to(sys.executable)
    except OSError:
        pytest.skip("no symbolic links here")
    keep = {name: os.environ[name] for name in ("PYTHONPATH", "SYSTEMROOT") if name in os.environ}
    done = subprocess.run(
        [sys.executable, "-m", "clvol", "doctor"],
        capture_output=True,
        encoding="utf-8",
        timeout=120,
        check=False,
        env={**keep, "PATH": str(tmp_path), "HOME": str(tmp_path), "USERPROFILE": str(tmp_path)},
    )
    lines = [line for line in done.stdout.splitlines() if "(optional)" not in line]
    assert device.name in lines[0], done.stdout + done.stderr
    if intel.library() or not all(d.is_pocl for d in devices()):
        assert done.returncode == 0
        assert any(line.startswith("ok  it computes right values") for line in lines)
        assert not any("the one that is used" in line and "Portable" in line.split(": ")[1] for line in lines)
    else:
        assert done.returncode == 1
        assert lines[2].startswith(
            "--  it builds kernels: PoCL needs the linker 'ld' to finish a kernel, and there is none on PATH"
        )
        assert 'pip install "clvol[intel]"' in lines[2]
        assert "apt install binutils gcc" in lines[2]


def test_extras_match_the_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        doctor,
        "requires",
        lambda _: ["clvol[one,two]; extra == 'all'", "first >=3; extra == 'one'", 'Second-one[x]>=1; extra == "two"', "core>=1"],
    )
    assert doctor._packages("all") == ["first", "Second-one"]
    assert doctor._packages("on") == []
    checks = {check.check: check for check in doctor.extras()}
    assert checks["medical (optional)"].ok == all(map(installed, ["SimpleITK"]))
    assert not any(name.startswith(("pocl", "intel", "test", "dev")) for name in checks)


def installed(name: str) -> bool:
    from importlib.util import find_spec

    return find_spec(name) is not None


@pytest.mark.parametrize(
    ("system", "machine", "has"),
    [("linux", "x86_64", True), ("win32", "AMD64", True), ("linux", "aarch64", False), ("darwin", "arm64", False)],
)
def test_intels_wheels_are_required_on_supported_platforms(system: str, machine: str, has: bool) -> None:
    from packaging.requirements import Requirement  # pytest needs it too

    project = tomllib.loads((Path(__file__).resolve().parents[2] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    wanted = [Requirement(line) for line in project["optional-dependencies"]["intel"]]
    assert {one.name for one in wanted} == {"intel-opencl-rt", "intel-cmplr-lib-rt"}
    for one in wanted:
        assert one.marker is not None
        assert one.marker.evaluate({"sys_platform": system, "platform_machine": machine}) is has


def test_threads_may_search_for_devices_first(device: Device) -> None:
    """Each would set the loader's variables; only one does at a time, and the environment is restored."""
    assert device is not None
    code = (
        "import os, threading; from clvol.device import devices; before = dict(os.environ); names = []\n"
        "def look(): names.append([d.name for d in devices()])\n"
        "threads = [threading.Thread(target=look) for _ in range(4)]\n"
        "[t.start() for t in threads]; [t.join() for t in threads]\n"
        "keys = ('OCL_ICD_VENDORS', 'OCL_ICD_FILENAMES')\n"
        "print(len(names) == 4 and all(n == names[0] for n in names), [os.environ.get(k) == before.get(k) for k in keys])\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, encoding="utf-8", timeout=120, check=False)
    assert done.stdout.strip() == "True [True, True]", done.stderr


def test_a_frame_with_intels_runtime_is_correct() -> None:
    if intel.library() is None:
        pytest.skip("Intel's runtime is not installed")
    (found,) = [d for d in devices() if "intel" in d.platform.lower() and d.kind == "cpu"]
    assert as_device() is found or as_device().is_pocl or as_device().kind == "gpu"
    camera = clvol.Camera.orbit(20, 10)
    with clvol.Renderer(clvol.phantoms.sphere(24, radius=0.4), "bspline3", device=found) as renderer:
        given = renderer.render(camera, "isosurface", isovalue=0.5, size=(48, 48), outputs=["position", "normal"])
    met = np.isfinite(given["position"]).all(-1)
    assert 0.03 < met.mean() < 0.9
    np.testing.assert_allclose(np.linalg.norm(given["position"][met], axis=-1), 0.4, atol=1e-4)
    along = (given["position"][met] / 0.4 * given["normal"][met]).sum(-1)
    np.testing.assert_allclose(np.abs(along), 1, atol=1e-4)
