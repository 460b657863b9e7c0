import pytest

from nilbs.app.main import main


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        ("trian hero.obj", "train"),
        ("train --method nilb hero.obj", "nilbs"),
        ("voxelize hero.nilbs --frame 0 --quantity ocupancy -o grid.npz", "occupancy"),
        ("evaluate hero.nilbs --rows serach", "search"),
        ("info hero.obj --jsno", "--json"),
        ("--versoin info hero.obj", "--version"),
    ],
)
def test_an_error_names_the_nearest_word(words: str, meant: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(words.split())
    assert end.value.code == 2
    assert capsys.readouterr().err.endswith(f"(the nearest: '{meant}')\n")


def test_what_is_like_no_option_is_refused_without_one(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["info", "hero.obj", "--q"])
    assert capsys.readouterr().err.endswith("unrecognized arguments: --q\n")
