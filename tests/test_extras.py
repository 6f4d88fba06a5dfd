"""A missing optional package is reported with its extra."""

from __future__ import annotations

import subprocess
import sys

import pytest


@pytest.mark.parametrize(
    ("missing", "code"),
    [
        ("torch", "import clvol.torch; clvol.torch.sample(None, None)"),
        ("jax", "import clvol.jax; clvol.jax.sample(None, None)"),
        ("xarray", "import clvol.xarray"),
        ("monai", "import clvol.monai"),
        ("nitransforms", "import clvol.nitransforms"),
        ("torchio", "import clvol.torchio"),
        ("nnunet", "import clvol.nnunet; sys.modules['nnunetv2'] = None; clvol.nnunet.install()"),
        ("dask", "import clvol.dask"),
    ],
)
def test_a_missing_package_is_named_with_its_extra(missing: str, code: str) -> None:
    hidden = f"import sys; sys.modules[{missing!r}] = None; {code}"
    done = subprocess.run([sys.executable, "-c", hidden], capture_output=True, encoding="utf-8", timeout=60, check=False)
    assert done.stderr.strip().splitlines()[-1].endswith(f'pip install "clvol[{missing}]"'), done.stderr
    assert "MissingDependencyError" in done.stderr


def test_the_command_for_nnunet_names_the_extra_in_one_line() -> None:
    hidden = "import sys, runpy; sys.modules['nnunetv2'] = None; runpy.run_module('clvol.nnunet', run_name='__main__')"
    done = subprocess.run([sys.executable, "-c", hidden], capture_output=True, encoding="utf-8", timeout=60, check=False)
    assert done.returncode == 1
    assert done.stderr == 'python -m clvol.nnunet: clvol.nnunet.install needs nnU-Net: pip install "clvol[nnunet]"\n'
