"""Fuzz one reader, guided by the coverage of nilbs.io, until the time is up or it does what no reader may.

PYTHONPATH=tests python -m fuzz READER [--seconds 600] [--keep FOLDER]
"""

import argparse
import os
import resource
import sys
import tempfile
import time
import warnings
from pathlib import Path
from random import Random

import atheris

with atheris.instrument_imports(include=["nilbs.io"]):
    from .readers import CORPUS, READERS, folder_in_memory, read_or_refused

MEMORY = 2**30  # bytes that reading one file may take
SECONDS = 5.0  # of processor time that reading one file may take


def fuzz(name: str, folder: Path, found: Path, seconds: int) -> None:
    """Never returns: libFuzzer ends the process."""
    warnings.simplefilter("ignore")  # of what changes files; those of readers are errors

    def one(content: bytes) -> None:
        # Beyond what is taken already: the fuzzer's own tables grow by a kilobyte a run.
        taken = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (taken + MEMORY, resource.RLIM_INFINITY))
        start = time.process_time()
        read_or_refused(name, content, folder)
        if time.process_time() - start > SECONDS:
            raise TimeoutError(f"reading {len(content)} bytes took more than {SECONDS} s")

    def mutate(content: bytes, max_size: int, seed: int) -> bytes:
        def mutate_bytes(part: bytes) -> bytes:
            return atheris.Mutate(part, max(len(part) + 64, 64))

        return READERS[name].mutate(content, Random(seed), mutate_bytes)[:max_size]

    # Processor time is what is limited; the limit of libFuzzer, in seconds by the clock, catches what never ends.
    flags = [f"-max_total_time={seconds}", "-timeout=60", "-rss_limit_mb=0", "-print_final_stats=1"]
    args = [sys.argv[0], *flags, f"-artifact_prefix={found}-", str(found), str(CORPUS / name)]
    atheris.Setup(args, one, custom_mutator=mutate)
    atheris.Fuzz()


def main() -> int:
    parser = argparse.ArgumentParser(prog="fuzz", description=__doc__.splitlines()[0])
    parser.add_argument("reader", choices=READERS)
    parser.add_argument("--seconds", type=int, default=600)
    parser.add_argument("--keep", type=Path, default=Path("out/fuzz"), help="where files that it found are kept")
    given = parser.parse_args()
    found = given.keep / given.reader
    found.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder_in_memory()) as folder:
        child = os.fork()  # for only a process that libFuzzer does not end can tidy up
        if child == 0:
            fuzz(given.reader, Path(folder), found, given.seconds)
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


sys.exit(main())
