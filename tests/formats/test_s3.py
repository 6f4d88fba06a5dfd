"""Stores in an S3-like object store: a local server of this test, at an address that no other machine reaches."""

from __future__ import annotations

import importlib
import logging
import pickle
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clvol
from clvol.base.errors import ClvolError, FormatError, MissingDependencyError, OptionError

zarr = pytest.importorskip("zarr")
s3fs = pytest.importorskip("s3fs")
pytest.importorskip("flask_cors")  # what moto's server needs
moto_server = pytest.importorskip("moto.server")

PASSWORD = "a-secret-of-the-test"
DATA = np.random.default_rng(2).integers(0, 60000, (40, 36, 44)).astype(np.uint16)
PATIENT = {"connect_timeout": 30, "read_timeout": 30, "retries": {"max_attempts": 0}}  # the server is slow on a busy machine
IMPATIENT = PATIENT | {"connect_timeout": 1, "read_timeout": 1}


@pytest.fixture(autouse=True)
def _own_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    """None of the machine's settings: no profile is read, and only this server is contacted."""
    for name in (
        "AWS_PROFILE",
        "AWS_ACCESS_KEY_ID",
        "AWS_SECRET_ACCESS_KEY",
        "AWS_SESSION_TOKEN",
        "AWS_ENDPOINT_URL",
        "HTTP_PROXY",
    ):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("AWS_EC2_METADATA_DISABLED", "true")
    monkeypatch.setenv("AWS_CONFIG_FILE", "/nonexistent")
    monkeypatch.setenv("AWS_SHARED_CREDENTIALS_FILE", "/nonexistent")
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    monkeypatch.setattr(s3fs.S3FileSystem, "retries", 1)  # by default 5, each after twice the time


def options(port: int, **others: Any) -> dict[str, Any]:
    known = {"key": "user-of-the-test", "secret": PASSWORD, "endpoint_url": f"http://127.0.0.1:{port}", "config_kwargs": PATIENT}
    return known | others


@pytest.fixture(scope="module")
def near(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("s3") / "cells.zarr"
    clvol.pyramid(clvol.Volume(DATA, (1, 1, 2), units="um"), path, chunks=16, filter="bspline3")
    return path


@pytest.fixture(scope="module")
def server(near: Path) -> Iterator[int]:
    """The port of a server with the store in a bucket."""
    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    server = moto_server.ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    port: int = server.get_host_and_port()[1]
    files = s3fs.S3FileSystem(**options(port, config_kwargs={}), skip_instance_cache=True)
    files.mkdir("bucket")
    files.put(str(near), "bucket/cells.zarr", recursive=True)
    yield port
    server.stop()


def test_a_store_in_a_bucket(server: int, near: Path) -> None:
    """Samples, levels and bounds are those of the folder, and so is a picture by bricks, bit for bit."""
    here, far = clvol.open(near), clvol.open("s3://bucket/cells.zarr", storage_options=options(server))
    assert (far.shape, far.spacing, far.units, len(far.levels)) == (here.shape, here.spacing, "um", len(here.levels))
    np.testing.assert_array_equal(far.read((5, 11, 3), (33, 30, 18)), DATA[3:18, 11:30, 5:33])
    for level, same in zip(far.levels, here.levels, strict=True):
        np.testing.assert_array_equal(level.whole().data, same.whole().data)
    assert far.bounds is not None
    assert here.bounds is not None
    assert far.bounds.within((0, 0, 0), (9, 9, 9)) == here.bounds.within((0, 0, 0), (9, 9, 9))
    pictures = []
    for volume in (here, far):
        with clvol.BrickedField(volume, "linear", edge=16) as field, clvol.Renderer(field) as renderer:
            pictures.append(renderer.render(mode="mip", size=(24, 18), lod=0))
            assert field.reads.bricks > 1
    np.testing.assert_array_equal(*pictures)


def test_an_array_of_zarr_by_obstore(server: int, near: Path) -> None:
    """The same picture, bit for bit; a server that is gone is an error."""
    s3 = pytest.importorskip("obstore.store").S3Store
    from zarr.storage import ObjectStore

    def lazy(port: int, bucket: str = "bucket") -> clvol.LazyVolume:
        store = s3(
            bucket,
            prefix="cells.zarr/0",
            endpoint=f"http://127.0.0.1:{port}",
            access_key_id="user-of-the-test",
            secret_access_key=PASSWORD,
            region="us-east-1",
            client_options={"allow_http": True, "timeout": "30s"},
            retry_config={"max_retries": 0},
        )
        return clvol.LazyVolume(zarr.open_array(ObjectStore(store, read_only=True), mode="r"), spacing=(1, 1, 2))

    pictures = []
    for volume in (clvol.open(near), lazy(server)):
        with clvol.BrickedField(volume, "linear", edge=16) as field, clvol.Renderer(field) as renderer:
            pictures.append(renderer.render(mode="mip", size=(24, 18), **({"lod": 0} if volume.levels else {})))
            assert field.reads.bricks > 1
    np.testing.assert_array_equal(*pictures)
    other = moto_server.ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    other.start()
    port = other.get_host_and_port()[1]
    far = lazy(port)
    other.stop()
    fails(lambda: far.read((0, 0, 0), (20, 20, 20)), "samples")


def test_another_process_reopens_it(server: int) -> None:
    far = clvol.open("s3://bucket/cells.zarr", storage_options=options(server))
    code = "import pickle, sys; print(int(pickle.load(sys.stdin.buffer).read((0, 0, 0), (44, 36, 40)).sum()))"
    done = subprocess.run([sys.executable, "-c", code], input=pickle.dumps(far), capture_output=True, timeout=60, check=True)
    assert int(done.stdout) == int(DATA.sum())


def fails(call: Callable[[], Any], match: str, seconds: float = 30.0) -> None:
    """Require a prompt, typed error that names the cause and reveals no secrets."""
    begun = time.monotonic()
    with pytest.raises(FormatError, match=match) as caught:
        call()
    assert time.monotonic() - begun < seconds
    assert PASSWORD not in str(caught.value)


def test_missing_buckets_and_chunks_are_named(server: int) -> None:
    about = options(server)
    fails(lambda: clvol.open("s3://nowhere/cells.zarr", storage_options=about), r"no Zarr.* at s3://nowhere/cells\.zarr.*bucket")
    fails(lambda: clvol.open("s3://bucket/gone.zarr", storage_options=about), r"no Zarr.* at s3://bucket/gone\.zarr")
    store = zarr.storage.FsspecStore.from_url("s3://bucket/flat.zarr", storage_options=about, read_only=False)
    array = zarr.create_array(store, shape=(8, 8, 8), chunks=(4, 4, 4), dtype="u2", zarr_format=2, fill_value=None)
    array[:] = 3
    s3fs.S3FileSystem(**about).rm("bucket/flat.zarr/1.0.1")
    lazy = clvol.open("s3://bucket/flat.zarr", storage_options=about)
    assert (lazy.read((0, 0, 0), (4, 8, 8)) == 3).all()
    fails(lazy.whole, r"samples \[0:8, 0:8, 0:8\].*flat\.zarr.*1\.0\.1 is missing")
    with pytest.raises(OptionError, match=r"written to a folder.*s3://bucket/new\.zarr"):
        clvol.pyramid(lazy, "s3://bucket/new.zarr")


def test_a_denied_read_is_reported_without_the_password(server: int) -> None:
    def checked(count: bytes) -> None:
        """Wrap the server: after n requests it checks credentials."""
        address = f"http://127.0.0.1:{server}/moto-api/reset-auth"
        urllib.request.urlopen(urllib.request.Request(address, count, {"Content-Type": "text/plain"})).close()

    far = clvol.open("s3://bucket/cells.zarr", storage_options=options(server))
    assert PASSWORD not in repr(far) + repr(far.data) + str(far.levels)
    checked(b"0")
    try:
        fails(lambda: far.read((0, 0, 0), (4, 4, 4)), r"samples \[0:4, 0:4, 0:4\].*chunk 0/c/0/0/0 of cells\.zarr")
        about = options(server, key="somebody-else")
        fails(lambda: clvol.open("s3://bucket/cells.zarr", storage_options=about), r"cannot read \S+ of cells\.zarr")
    finally:
        checked(b"inf")


def test_secrets_are_removed_from_library_messages() -> None:
    from clvol.formats.zarr.addresses import said, shown

    address = "https://me:my-password@server.org/a/v.zarr?X-Signature=0123456789"
    about = {"client_kwargs": {"headers": [("Authorization", "Bearer of-news")]}, "endpoint_url": "http://root:toor-toor@host:1/x"}
    assert shown(address) == "https://server.org/a/v.zarr"
    error = OSError(f"404 of {address} with Bearer of-news at http://root:toor-toor@host:1/x, in eu-west")
    assert said(error, address, about) == "404 of https://...@server.org/a/v.zarr?... with ... at http://...@host:1/x, in eu-west"


def test_a_server_that_stops_or_hangs_is_named_in_bounded_time(server: int) -> None:  # noqa: ARG001  # who filled the bucket
    own = moto_server.ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    own.start()
    about = options(own.get_host_and_port()[1])  # it has the buckets of the other one
    far = clvol.open("s3://bucket/cells.zarr", storage_options=about)
    own.stop()
    fails(lambda: far.read((0, 0, 0), (4, 4, 4)), r"samples \[0:4, 0:4, 0:4\].*chunk 0/c/0/0/0 of cells\.zarr.*connect")
    fails(lambda: clvol.open("s3://bucket/cells.zarr", storage_options=about), r"\S+ of cells\.zarr.*connect")
    with socket.create_server(("127.0.0.1", 0)) as silent:  # it accepts requests, and never answers
        about = options(silent.getsockname()[1], config_kwargs=IMPATIENT)
        fails(lambda: clvol.open("s3://bucket/cells.zarr", storage_options=about), r"\S+ of cells\.zarr.*[Tt]imeout")


def test_without_its_library_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    known = importlib.import_module("fsspec.registry")._registry  # what was imported before
    for name in ("s3", "s3a"):
        monkeypatch.delitem(known, name, raising=False)
    monkeypatch.setitem(sys.modules, "s3fs", None)
    with pytest.raises(MissingDependencyError, match=r's3://bucket/v\.zarr needs .*pip install "clvol\[s3\]"'):
        clvol.open("s3://bucket/v.zarr")
    with pytest.raises(ClvolError, match=r"nowhere"):
        clvol.open("nowhere://v.zarr")
