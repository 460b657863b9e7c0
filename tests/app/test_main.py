import errno
import os
import signal
import subprocess
import sys

import pytest

from nilbs.app.commands import info
from nilbs.app.main import COMMANDS, main


def raising(monkeypatch, error):
    def run(args):
        raise error

    monkeypatch.setattr(info, "run", run)


def process(*words, code="import sys; from nilbs.app.main import main; sys.exit(main())", **options):
    return subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True, timeout=60, **options)


@pytest.mark.parametrize("command", ["", *COMMANDS])
def test_help(capsys, command):
    with pytest.raises(SystemExit) as caught:
        main([*command.split(), "--help"])
    assert caught.value.code == 0
    out = capsys.readouterr().out
    assert out.startswith(f"usage: nilbs {command}".rstrip())
    if not command:
        assert all(name in out for name in COMMANDS)


@pytest.mark.parametrize(
    "words",
    [
        [],
        ["bake"],
        ["info"],
        ["train", "a.obj", "a.tgf"],
        ["train", "a.obj", "a.tgf", "-o", "a.nilbs", "--frames", "0"],
        ["train", "a.obj", "a.tgf", "-o", "a.nilbs", "--seed", "-1"],
        ["train", "a.obj", "a.tgf", "-o", "a.nilbs", "--amplitude", "nan"],
        ["train", "a.obj", "a.tgf", "-o", "a.nilbs", "--amplitude", "wild"],
        ["extract", "a.nilbs", "-o", "a.obj"],
        ["extract", "a.nilbs", "--frame", "one", "-o", "a.obj"],
        ["extract", "a.nilbs", "--frame", "0", "--resolution", "1", "-o", "a.obj"],
    ],
)
def test_options_that_cannot_be_read(capsys, words):
    with pytest.raises(SystemExit) as caught:
        main(words)
    assert caught.value.code == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert "error: " in err.splitlines()[-1]


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (ValueError("one\n  two"), "one two"),
        (OSError(errno.ENOSPC, "No space left on device", "a.npz"), "a.npz: No space left on device"),
        (OSError("odd"), "odd"),
        (MemoryError("Unable to allocate 1 TiB"), "not enough memory: Unable to allocate 1 TiB"),
        (MemoryError(), "not enough memory"),
        (RuntimeError("CUDA out of memory"), "not enough memory: CUDA out of memory"),
        (FloatingPointError("the loss is nan"), "the loss is nan"),
        (ModuleNotFoundError("No module", name="igl.core"), "the package igl is not installed: pip install libigl"),
        (ModuleNotFoundError("No module", name="torch"), "the package torch is not installed: pip install torch"),
        (ValueError(), "ValueError"),
    ],
)
def test_an_error_is_one_line_and_status_2(monkeypatch, fails, error, line):
    raising(monkeypatch, error)
    assert fails("info", "a.obj") == line


@pytest.mark.parametrize(
    "error", [RuntimeError("broken"), ModuleNotFoundError("No module", name="nilbs.nothing"), KeyError("broken")]
)
def test_an_error_of_ours_shows_itself(monkeypatch, error):
    raising(monkeypatch, error)
    with pytest.raises(type(error)):
        main(["info", "a.obj"])


def test_debug_shows_every_traceback(monkeypatch):
    monkeypatch.setenv("NILBS_DEBUG", "1")
    with pytest.raises(FileNotFoundError):
        main(["info", "no-such-file.obj"])


def test_an_interrupt_is_one_line_and_status_130(monkeypatch, nilbs):
    interrupt = KeyboardInterrupt()
    interrupt.add_note("go on with --resume")
    raising(monkeypatch, interrupt)
    assert nilbs("info", "a.obj") == (130, "", "nilbs: interrupted; go on with --resume\n")


def test_a_reader_that_went_away_is_no_error(monkeypatch, nilbs):
    raising(monkeypatch, BrokenPipeError())
    assert nilbs("info", "a.obj") == (1, "", "")


def test_a_closed_pipe_is_quiet(assets):
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "w") as closed:
        words = [sys.executable, "-m", "nilbs", "info", str(assets / "bar.tgf")]
        done = subprocess.run(words, stdout=closed, stderr=subprocess.PIPE, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (1, "")


def test_a_full_disk_behind_standard_output(assets):
    with open("/dev/full", "w") as full:
        words = [sys.executable, "-m", "nilbs", "info", str(assets / "bar.tgf"), "--json"]
        done = subprocess.run(words, stdout=full, stderr=subprocess.PIPE, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (2, "nilbs: error: standard output: No space left on device\n")


@pytest.mark.parametrize("closed", [">&-", "2>&-", ">&- 2>&-"])
def test_a_closed_output_is_written_to_in_vain(assets, closed):
    words = f'"{sys.executable}" -m nilbs weights "{assets}/bar2.obj" "{assets}/bar.tgf" --json {closed}'
    done = subprocess.run(words, shell=True, capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("{") == (closed == "2>&-")


def test_a_name_that_the_terminal_has_no_letters_for(assets, tmp_path):
    path = tmp_path / "köper.tgf"
    path.write_bytes((assets / "bar.tgf").read_bytes())
    words = [sys.executable, "-m", "nilbs", "info", str(path)]
    ascii_only = os.environ | {"PYTHONIOENCODING": "ascii"}
    done = subprocess.run(words, capture_output=True, text=True, timeout=60, env=ascii_only)
    assert (done.returncode, done.stderr) == (0, "")
    assert "k\\xf6per.tgf" in done.stdout


def test_ctrl_c(tmp_path):
    code = (
        "import signal, sys, time; from nilbs.app import main; from nilbs.app.commands import info; "
        "signal.signal(signal.SIGINT, signal.default_int_handler); "
        "info.run = lambda args: (print('on', flush=True), time.sleep(60));"
        "sys.exit(main.main(['info', 'a.obj']))"
    )
    words = [sys.executable, "-c", code]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as running:
        assert running.stdout.readline() == "on\n"
        running.send_signal(signal.SIGINT)
        out, err = running.communicate(timeout=60)
    assert (running.returncode, out, err) == (130, "", "nilbs: interrupted\n")


def test_the_module_runs_as_the_command(assets):
    done = subprocess.run([sys.executable, "-m", "nilbs", "--version"], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0
    assert done.stdout.startswith("nilbs ")


@pytest.mark.parametrize("command", ["", *COMMANDS])
def test_help_imports_nothing_heavy(command):
    code = (
        "import sys; from nilbs.app.main import main\ntry: main()\nexcept SystemExit: pass\n"
        "print(sorted({'numpy', 'torch', 'igl', 'scipy', 'matplotlib', 'tqdm', 'skimage'} & set(sys.modules)))"
    )
    done = process(*command.split(), "--help", code=code)
    assert done.stdout.splitlines()[-1] == "[]", done.stderr


def test_lower_layers_import_no_torch():
    code = (
        "import sys, nilbs; print(sorted({'torch', 'trimesh', 'igl'} & set(sys.modules)));"
        "import nilbs.geometry, nilbs.io; print(sorted({'torch', 'trimesh', 'igl'} & set(sys.modules)))"
    )
    assert process(code=code).stdout == "[]\n[]\n"
