"""Compiled code: functions that numba compiles and keeps on disk, and the threads that run them.

Compiled functions release the interpreter lock and start no threads of their own. The threads are Python's, made anew
in a forked process, so that an engine may be used from several threads, after fork and after spawn.
"""

import hashlib
import os
import sys
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

try:
    import numba
    from numba.core.caching import FunctionCache, IndexDataCacheFile
except (ImportError, OSError, AttributeError, SystemError) as error:  # not installed, or it does not fit numpy
    PROBLEM: str | None = " ".join(str(error).split()) or type(error).__name__
else:
    PROBLEM = None

Function = TypeVar("Function", bound=Callable[..., Any])
# A test for NaN must stay a test, so that of the fast-math flags those that assume finite numbers are left out.
FLAGS = {"contract", "arcp", "nsz", "reassoc"}


def compiled(function: Function) -> Function:
    """The function compiled by numba, when it is first called with arguments of these types.

    It makes no arrays, so that nothing counts references to those that it has: threads that count the same references
    wait for each other. Without numba it stays as it is; see `available`.
    """
    return _dispatcher(function, _nrt=False)


def inlined(function: Function) -> Function:
    """A small compiled function whose code is put in the place of every call; see `compiled`."""
    return _dispatcher(function, _nrt=False, forceinline=True)


def allocating(function: Function) -> Function:
    """A compiled function that makes arrays, and is therefore not for many points; see `compiled`."""
    return _dispatcher(function)


def _dispatcher(function: Function, **options: Any) -> Function:
    if PROBLEM is not None:
        return function
    dispatcher = numba.njit(nogil=True, error_model="numpy", fastmath=FLAGS, **options)(function)
    try:
        dispatcher._cache = _kept()(function)
    except (RuntimeError, OSError) as error:
        announce(f"compiled code cannot be kept on disk, so that every process compiles anew ({error})")
    return dispatcher


def available() -> bool:
    """Whether there is a compiler; if there is none, one line on standard error tells so, once."""
    if PROBLEM is None:
        return True
    announce(
        f"numba cannot be imported ({PROBLEM}): answers are computed without the compiled engine, many times slower"
    )
    return False


@cache
def announce(message: str) -> None:
    """One line on standard error, once in a process."""
    print(f"nilbs: {message}", file=sys.stderr, flush=True)


def set_threads(count: int | None) -> None:
    """How many threads the engine uses from now on; None: NILBS_THREADS or OMP_NUM_THREADS, or else all cores."""
    global _threads
    if count is not None and count < 1:
        raise ValueError(f"count must be at least 1, got {count}")
    _threads = count


def threads() -> int:
    """How many threads the engine uses."""
    if _threads is not None:
        return _threads
    for name in ("NILBS_THREADS", "OMP_NUM_THREADS"):
        if (value := os.environ.get(name, "")).isdecimal() and int(value) > 0:
            return int(value)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def in_pieces(function: Callable[[int, int], Any], n: int, *, piece: int) -> None:
    """Call a function of (begin, end) for pieces of the range n, on this thread and on the others.

    Inside a piece further pieces are called one after the other: a thread that waits for others of the same threads
    may wait forever.
    """
    begins = iter(range(0, n, piece))  # from which every thread takes the next

    def work() -> None:
        for begin in begins:
            function(begin, min(begin + piece, n))

    helpers = min(threads(), -(-n // piece)) - 1
    if helpers < 1 or _thread.has_piece:
        work()
        return
    started = [_pool(os.getpid(), threads() - 1).submit(work) for _ in range(helpers)]
    _thread.has_piece = True
    try:
        work()
    finally:
        _thread.has_piece = False
        # One that has not begun has nothing left to do.
        begun = [helper for helper in started if not helper.cancel()]
        wait(begun)
    for helper in begun:
        helper.result()


def each(function: Callable[[int], Any], count: int) -> None:
    """Call a function of k for k = 0 .. count-1, which calls `in_pieces` itself.

    If there are as many calls as threads, each runs on one thread; else one after the other on all.
    """
    if count >= threads():
        in_pieces(lambda begin, end: function(begin), count, piece=1)
        return
    for k in range(count):
        function(k)


class _Thread(threading.local):
    """Whether this thread works on a piece."""

    has_piece = False


_threads: int | None = None
_thread = _Thread()


@cache
def _pool(process: int, count: int) -> ThreadPoolExecutor:
    """The threads of a process; a forked one has its own."""
    return ThreadPoolExecutor(
        count, thread_name_prefix="nilbs", initializer=setattr, initargs=(_thread, "has_piece", True)
    )


@cache
def _kept() -> Any:
    """The class that keeps compiled functions on disk: numba's, where any change of the engine makes files stale."""
    stamp = hashlib.sha256()
    for path in sorted(Path(__file__).parent.glob("*.py")):
        stamp.update(path.read_bytes())

    class Kept(FunctionCache):
        def __init__(self, function: Callable[..., Any]) -> None:
            super().__init__(function)
            # numba looks at the file of the function, but what it calls is compiled into it.
            self._cache_file = IndexDataCacheFile(self._cache_path, self._impl.filename_base, stamp.hexdigest())

        def load_overload(self, sig: Any, target_context: Any) -> Any:
            try:
                found = super().load_overload(sig, target_context)
            except Exception:  # a damaged file, of which unpickling may raise anything
                found = None
            if found is None:
                announce("compiling the engine; later processes load what this one keeps")
            return found

        def save_overload(self, sig: Any, data: Any) -> None:
            try:
                super().save_overload(sig, data)
            except OSError as error:
                announce(f"compiled code cannot be kept on disk, so that every process compiles anew ({error})")

    return Kept
