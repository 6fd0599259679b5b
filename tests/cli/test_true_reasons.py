"""Faults of the host and of typing that have an innocent cause nearby: the true one is told."""

from __future__ import annotations

import errno
from dataclasses import replace
from pathlib import Path

import pytest

from rths_cli import user_cache
from rths_cli.case.load import load_cases
from rths_cli.cli import entry_point
from rths_cli.errors import InputError, out_of_memory
from rths_cli.experiment.identify_on_rig import probed
from rths_cli.experiment.model_files import Cache
from rths_cli.experiment.setup import make_setup
from rths_cli.files.machine_rates import held_rate
from rths_cli.files.rig_lock import locked_rig

CASE = "el_centro_low_ff_fb"
LATER = "table.after_identification.command_skew_s"


@pytest.mark.parametrize(
    "error",
    [
        MemoryError(),
        OSError(errno.ENOMEM, "Cannot allocate memory"),
        ImportError("libx.so: failed to map segment from shared object"),
        RuntimeError("can't start new thread"),
    ],
)
def test_too_little_memory_is_a_sentence_and_no_crash_file(
    error: Exception, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    def fail(**_: object) -> int:
        raise RuntimeError("of a library") from error

    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr("sys.argv", ["rths", "list", "cases"])
    monkeypatch.setattr(entry_point.cli, "main", fail)
    assert entry_point.run_to_exit_code() == 2
    assert "there is too little memory" in capsys.readouterr().err and list(tmp_path.iterdir()) == []
    assert out_of_memory(OSError(errno.EACCES, "Permission denied")) == "" == out_of_memory(ValueError("of ours"))


def test_without_a_home_models_are_kept_for_the_process_and_a_real_rig_is_not_moved(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def homeless() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(Path, "home", homeless)
    folder = user_cache.cache_or_temporary()
    assert folder.is_dir() and folder.stat().st_mode & 0o077 == 0
    assert not Cache().has(make_setup(load_cases([CASE])[0]))
    assert held_rate(1000.0) is None
    with pytest.raises(InputError, match="set XDG_CACHE_HOME"), locked_rig("shaker"):
        pass


@pytest.mark.parametrize(
    ("settings", "refused"),
    [
        (("sample_rate_hz=1000", f"{LATER}=4.4e-4"), ""),
        (("sample_rate_hz=1000", f"{LATER}=-4.6e-4"), f"{LATER}: must be within +-450 us, 0.45 of the sample interval"),
        (("sample_rate_hz=4000", f"{LATER}=2e-4"), f"{LATER}: must be within +-112.5 us"),
        (("sample_rate_hz=4000", f"{LATER}=5e-3", "table.converters.latency_samples=0"), ""),
    ],
)
def test_a_command_too_late_for_its_interval_is_refused_before_the_identification_by_the_key_that_was_written(
    settings: tuple[str, ...], refused: str
) -> None:
    case = load_cases([CASE], settings)[0]
    if not refused:
        make_setup(case)
        return
    with pytest.raises(InputError) as caught:
        make_setup(case)
    (told,) = caught.value.faults
    assert refused in told and "imperfections" not in told


def test_what_is_to_be_played_on_a_real_rig_is_not_told_as_if_it_moved(monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []

    class Refused(Exception):
        """Raised in place of a motion."""

    def excite(*_: object, **__: object) -> None:
        raise Refused

    setup = make_setup(load_cases([CASE])[0])
    real = replace(setup, rig=replace(setup.rig, kind="udp"))
    monkeypatch.setattr("rths_cli.experiment.identify_on_rig.excite", excite)
    with pytest.raises(Refused):
        probed(real, said.append)
    assert len(said) == 1 and said[0].startswith("probe of ") and said[0].endswith("getting ready, nothing moves yet")


def test_a_fault_of_ours_after_a_busy_file_is_not_too_little_memory() -> None:
    try:
        try:
            raise BlockingIOError(errno.EAGAIN, "Resource temporarily unavailable")
        except BlockingIOError:
            raise ValueError("of ours")  # noqa: B904
    except ValueError as error:
        assert out_of_memory(error) == ""
    try:
        try:
            raise MemoryError
        except MemoryError:
            raise ValueError("of ours") from None
    except ValueError as error:
        assert out_of_memory(error) == ""
