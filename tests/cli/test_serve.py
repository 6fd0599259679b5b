"""`rths serve` as a process: what it prints, its key file, its ends."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import stat
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from portfolio import parametrize_first

from rths_cli.laboratory.serve import describe
from rths_cli.rigs.udp.udp_rig import UdpRig, UdpTarget

pytestmark = [
    pytest.mark.skipif(sys.platform != "linux", reason="real time is Linux only"),
    pytest.mark.real_time,
]
RTHS = [sys.executable, "-m", "rths_cli", "serve", "--port", "0"]


@contextmanager
def started(*words: str) -> Iterator[tuple[subprocess.Popen[str], str, int, Path]]:
    """Start a server; yield process, host, port and key file as it prints them."""
    process = subprocess.Popen([*RTHS, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        assert process.stdout
        first, second, third = (process.stdout.readline() for _ in range(3))
        where, key = re.search(r" at (.+):(\d+);", first), re.match(r"key file (.+?);", second)
        assert where and key, (first, second)
        assert third == f"export RTHS_KEY_FILE={key[1]}\n"  # alone on its line, to copy
        yield process, where[1], int(where[2]), Path(key[1])
    finally:
        process.kill()
        process.communicate()


@pytest.fixture
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Give the processes a cache of their own that holds the compiled code of this one."""
    from rths_cli.numerics.compiled import cache_folder

    compiled = cache_folder()
    assert compiled is not None
    (tmp_path / "rths").mkdir()
    os.symlink(compiled, tmp_path / "rths" / compiled.name)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "rths"


@pytest.mark.campaign
@parametrize_first(1, ("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_rests_the_table_and_ends_with_its_code(own_cache: Path, number: int, code: int) -> None:
    with started() as (process, host, port, key_file):
        assert (host, key_file) == ("127.0.0.1", own_cache / "serve.key")
        assert stat.S_IMODE(key_file.stat().st_mode) == 0o600
        info = describe("aps400_virtual", "three_storey", ("sample_rate_hz=200",), 0).setup.rig
        rig = UdpRig(info, UdpTarget(host, port, key_file, timeout_s=0.5))
        rig.open()
        rig.arm()
        for command in (0.0, 0.01, 0.02):
            rig.exchange(command)
        process.send_signal(number)
        out, err = process.communicate(timeout=20)
        rig.door.close() if rig.door else None
    assert process.returncode == code
    assert re.search(r"session 1 with 127\.0\.0\.1:\d+ at 200 Hz: 3 commands, .*ended: the server was told to end", out)
    assert out.endswith("\nended; the table was led to rest\n")
    assert "Traceback" not in err


@pytest.mark.campaign
def test_the_key_file_is_kept_and_json_holds_the_sessions(own_cache: Path) -> None:
    open_to_all = [*RTHS, "--seconds", "0.1", "--host", "0.0.0.0"]
    first = subprocess.run(open_to_all, capture_output=True, text=True, timeout=120, check=True)
    key = (own_cache / "serve.key").read_text()
    done = subprocess.run([*RTHS, "--seconds", "0.1", "--json"], capture_output=True, text=True, timeout=60, check=True)
    assert (own_cache / "serve.key").read_text() == key and key not in first.stdout + done.stderr
    assert json.loads(done.stdout) == {"sessions": []}
    assert "warning: reachable from other machines" in first.stdout and "warning" not in done.stderr
    assert "serve.key" in done.stderr


@pytest.mark.campaign
def test_a_port_in_use_and_bad_input_are_one_sentence(own_cache: Path, tmp_path: Path) -> None:
    (tmp_path / "open.key").write_text("00" * 16)
    (tmp_path / "open.key").chmod(0o644)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        cases = [
            (("--port", str(taken.getsockname()[1])), 4, "choose another port"),
            (("--key-file", str(tmp_path / "none")), 2, "cannot be read"),
            (("--key-file", str(tmp_path / "open.key")), 2, "chmod 600"),
            (("no_such_rig",), 2, "no_such_rig"),
            (("--host", 300 * "a"), 2, "give a name or an address of this machine"),
        ]
        for words, code, said in cases:
            done = subprocess.run([*RTHS, *words], capture_output=True, text=True, timeout=60, check=False)
            assert (done.returncode, done.stdout) == (code, ""), words
            assert said in done.stderr and "Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--as", "target"), "--as target and --case CASE belong together"),
        (("--as", "target", "--case", "el_centro_low_ff_fb"), "is of kind virtual; only one of kind target"),
        (("--as", "target", "--case", "el_centro_low_ff_fb", "--clock", "runner"), "leave --clock, --link"),
        (("--as", "target", "--case", "el_centro_low_ff_fb", "--peer", "8.8.8.8:3"), "--peer: must be private"),
    ],
)
def test_what_may_not_be_served_as_a_target(words: tuple[str, ...], said: str) -> None:
    done = subprocess.run([*RTHS, *words], capture_output=True, text=True, check=False)
    assert done.returncode == 2 and said in done.stderr
