"""FBX files, by way of an installed Blender that turns them into GLB."""

import os
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from nilbs.io.bounded import file_bytes
from nilbs.io.bundle import Bundle
from nilbs.io.errors import FileFormatError
from nilbs.io.gltf import read_gltf
from nilbs.io.names import printable

_SECONDS = 600  # that Blender may take
_BINARY = b"Kaydara FBX Binary"
_NO_BLENDER = (
    "reading FBX needs Blender, and no program `blender` is found: install it, name it in the environment variable "
    "NILBS_BLENDER, or convert the file to .glb"
)
# Run by Blender's own Python. Which options there are depends on its version.
_SCRIPT = """
import sys
import bpy

source, target = sys.argv[sys.argv.index("--") + 1 :]
bpy.ops.wm.read_factory_settings(use_empty=True)
if "fbx" in dir(bpy.ops.import_scene):
    bpy.ops.import_scene.fbx(filepath=source, use_image_search=False, anim_offset=0.0)
else:
    bpy.ops.wm.fbx_import(filepath=source)
wanted = {
    "export_format": "GLB",
    "export_materials": "NONE",
    "export_morph": False,
    "export_all_influences": True,
    "export_influence_nb": 32,
}
known = bpy.ops.export_scene.gltf.get_rna_type().properties.keys()
bpy.ops.export_scene.gltf(filepath=target, **{name: value for name, value in wanted.items() if name in known})
"""


def read_fbx(path: str | os.PathLike) -> Bundle:
    """Read what Blender's copy of a binary FBX file as GLB holds, with lengths in metres and y up.

    Blender (`blender` on the PATH, or what the environment variable NILBS_BLENDER names) runs in the background for at
    most ten minutes, with its factory settings, so that no add-on and no start-up file of the user takes part.
    """
    if not file_bytes(path).startswith(_BINARY):
        raise FileFormatError(path, "this is no binary FBX file, the only form that Blender reads")
    blender = os.environ.get("NILBS_BLENDER") or shutil.which("blender")
    if not blender:
        raise FileFormatError(path, _NO_BLENDER)
    with TemporaryDirectory(prefix="nilbs-") as name:
        folder = Path(name)
        _convert(path, blender, folder)
        try:
            parts = read_gltf(folder / "copy.glb")
        except FileFormatError as error:
            raise FileFormatError(path, f"Blender's copy of it as GLB: {error.message}") from None
    note = "read by way of Blender, which writes lengths in metres with y up"
    return replace(parts, notes=(note, *parts.notes))


def _convert(path: str | os.PathLike, blender: str, folder: Path) -> None:
    """Have Blender write copy.glb to a folder."""
    (folder / "convert.py").write_text(_SCRIPT)
    options = ["--background", "--factory-startup", "--disable-autoexec", "--python-exit-code", "3"]
    files = [os.path.abspath(path), os.fspath(folder / "copy.glb")]
    program = os.path.abspath(blender) if os.path.dirname(blender) else blender  # it is started in another folder
    command = [program, *options, "--python", os.fspath(folder / "convert.py"), "--", *files]
    with open(folder / "log", "w+b") as log:
        try:
            done = subprocess.run(
                command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, cwd=folder, timeout=_SECONDS, check=False
            )
        except OSError as error:
            raise FileFormatError(path, f"Blender ({blender}) cannot be started: {error.strerror}") from None
        except subprocess.TimeoutExpired:
            raise FileFormatError(path, f"Blender was stopped: it took more than {_SECONDS} s") from None
        if done.returncode or not (folder / "copy.glb").is_file():
            log.seek(max(log.seek(0, os.SEEK_END) - 4000, 0))
            output = [line for line in log.read().decode("utf-8", "replace").splitlines() if line.strip()]
            # A report of Python's ends with the error; then Blender adds that the script failed and that it quits.
            errors = [line for line in output if "Error" in line and "script failed" not in line]
            last = printable((errors or output or ["nothing"])[-1].strip()[:200])
            raise FileFormatError(path, f"Blender could not convert it: {last}")
