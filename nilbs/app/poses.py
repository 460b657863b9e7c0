"""Which pose `--motion FILE --frame K` means."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np

    from nilbs.model import Model


def chosen_pose(model: "Model", motion_file: str | None, frame: int) -> "np.ndarray":
    """The pose that a user chose.

    Parameters
    ----------
    model : Model
    motion_file : str, optional
        The file of the motion; the one the model was trained on by default.
    frame : int
        Counted from 0.

    Returns
    -------
    pose : (b, d+1, d+1) float array

    Raises
    ------
    FileFormatError, ValueError, OSError
        If the file is no motion of this character, or has no such frame.
    """
    from nilbs.motion import read_motion

    motion = model.motion if motion_file is None else read_motion(motion_file, model.character)
    if not 0 <= frame < len(motion):
        name = "the motion of the model" if motion_file is None else motion_file
        raise ValueError(f"{name}: there is no frame {frame}; it has {len(motion)} frames, counted from 0")
    return motion[frame]
