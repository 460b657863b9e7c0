from concurrent.futures import ThreadPoolExecutor
from threading import get_ident

import pytest

from nilbs.engine.compiled import each, in_pieces, set_threads


@pytest.fixture(params=[1, 2, 3])
def threads(request):
    set_threads(request.param)
    yield request.param
    set_threads(None)


def test_pieces_are_the_whole_range(threads: int) -> None:
    for n in (0, 1, 5, 6):
        pieces: list[tuple[int, int]] = []
        in_pieces(lambda begin, end, found=pieces: found.append((begin, end)), n, piece=2)
        assert sorted(pieces) == [(begin, min(begin + 2, n)) for begin in range(0, n, 2)]


def test_pieces_within_pieces_stay_on_their_thread(threads: int) -> None:
    outer: dict[int, int] = {}
    inner: list[tuple[int, int]] = []

    def within(k: int) -> None:
        outer[k] = get_ident()
        in_pieces(lambda begin, end: inner.append((k, get_ident())), 4, piece=1)

    # More than there are threads, so that all would wait for each other.
    each(within, 2 * threads + 1)
    assert sorted(outer) == list(range(2 * threads + 1))
    assert sorted(inner) == sorted((k, outer[k]) for k in outer for _ in range(4))


def test_fewer_calls_than_threads_leave_all_of_them_to_the_pieces() -> None:
    set_threads(3)
    try:
        outer, inner = set(), set()

        def within(k: int) -> None:
            outer.add(get_ident())
            in_pieces(lambda begin, end: inner.add(get_ident()), 50, piece=1)

        each(within, 2)
    finally:
        set_threads(None)
    assert outer == {get_ident()}
    assert get_ident() in inner
    assert len(inner) <= 3


def test_several_threads_may_share_the_engine(threads: int) -> None:
    def total(n: int) -> int:
        found: list[int] = []
        each(lambda k: in_pieces(lambda begin, end: found.append(end - begin), k, piece=3), n)
        return sum(found)

    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(total, [20] * 8)) == [190] * 8


def test_a_failure_in_a_piece_is_raised(threads: int) -> None:
    def fails(k: int) -> None:
        in_pieces(lambda begin, end: 1 // (k - 3), 2, piece=1)

    with pytest.raises(ZeroDivisionError):
        each(fails, 5)
