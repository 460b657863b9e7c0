import io
import sys

import pytest

from nilbs.geometry import progress


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    now = [0.0]
    monkeypatch.setattr(progress, "monotonic", lambda: now[0])
    return now


def test_a_log_has_a_line_every_ten_seconds_and_one_at_the_end(clock, monkeypatch) -> None:
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    with progress.progress_bar(total=50, desc="frames") as bar:
        for second in range(1, 36):
            clock[0] = second
            bar.update()
            bar.set_postfix_str("left arm")
    lines = sys.stderr.getvalue().splitlines()
    assert [line.split(",")[0] for line in lines] == ["frames: 20 %", "frames: 40 %", "frames: 60 %", "frames: 70 %"]
    assert all("passed" in line and line.split(", ")[2].endswith(" left") for line in lines)
    assert lines[-1].endswith(", left arm")


def test_what_is_done_before_the_first_line_leaves_none(clock, monkeypatch) -> None:
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    assert list(progress.progress_bar(range(5))) == [0, 1, 2, 3, 4]
    assert sys.stderr.getvalue() == ""


@pytest.mark.parametrize("stream", [io.StringIO, Terminal])
def test_nothing_is_shown_where_none_is_wanted(stream, clock, monkeypatch) -> None:
    monkeypatch.setattr(sys, "stderr", stream())
    for _ in progress.progress_bar(range(5), shown=False, delay=0):
        clock[0] += 20
    assert sys.stderr.getvalue() == ""


def test_a_terminal_has_a_bar(monkeypatch) -> None:
    monkeypatch.setattr(sys, "stderr", Terminal())
    assert list(progress.progress_bar(range(5), desc="frames", delay=0)) == [0, 1, 2, 3, 4]
    assert "\rframes: 100%|" in sys.stderr.getvalue()
