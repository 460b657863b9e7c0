"""The search on a GPU, in processes of its own: without a GPU Triton interprets its code, if told at import.

Usage: python gpu_answers.py FOLDER, where questions.npz holds `MODEL.CASE.x` and `MODEL.CASE.pose` of the files
MODEL.nilbs; levels, canonical points and, of the case "few", completed distances go to answers.npz. In the case
"decoys" most cells lead nowhere, and `expected` are levels of the compiled engine with the same cells. Or: python
gpu_answers.py 2 (or 3), which prints the code for an H100 that answers in so many dimensions.
"""

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from nilbs.engine.search import SearchEngine


def main(folder: Path) -> None:
    import torch

    from nilbs.fields.gpu_search import GpuSearch
    from nilbs.models import torch_field
    from nilbs.models.model import load_model

    if not torch.cuda.is_available():
        hurry()
        torch_field.gpu_engine = lambda engine, device: GpuSearch(engine, "cpu")  # type: ignore[assignment,return-value]
    models, answers = {}, {}
    with np.load(folder / "questions.npz") as questions:
        for name in {key.rpartition(".")[0] for key in questions}:
            model = name.partition(".")[0]
            if model not in models:
                models[model] = load_model(folder / f"{model}.nilbs").to(device="cuda")
            x, pose = questions[f"{name}.x"], questions[f"{name}.pose"]
            if name.endswith(".decoys"):
                c, frame, engine = models[model].character, models[model].posed(pose).frame, models[model].engine()
                decoys = with_decoys(engine.engine)
                answers[f"{name}.expected"] = decoys(frame.B)(x, frame.to_unit).level
                found = GpuSearch(decoys, engine.device)(frame.B)(x, frame.to_unit).in_mesh_units(c.L, c.center)
            else:
                found = models[model].answer(torch.as_tensor(x), torch.as_tensor(pose))
            for key in ("level", "x_rest"):
                answers[f"{name}.{key}"] = torch.as_tensor(getattr(found, key)).cpu().numpy()
            if name.endswith(".few"):
                answers[f"{name}.distance"] = models[model].distance(x, pose)
    np.savez(folder / "answers.npz", **answers)


def with_decoys(engine: "SearchEngine") -> "SearchEngine":
    """The engine with five cells before each, from which searches begin far away: more than are tried at a time."""
    lattice = engine.lattice
    corner, center, edge = (np.tile(array, (6, 1)) for array in (lattice.corner, lattice.center, lattice.edge))
    center[: -len(lattice.center)] += 9
    return replace(engine, lattice=lattice._replace(corner=corner, center=center, edge=edge))


def hurry() -> None:
    """Let the interpreter prepare each function once, not in every call, and not look for overflows of integers."""
    from triton.runtime import interpreter

    class Kept:
        def restore(self) -> None:
            pass

    patch, done = interpreter._patch_lang, set()

    def patched(function: object) -> Kept:
        if function not in done:
            done.add(function)
            patch(function)
        return Kept()

    interpreter._patch_lang = patched
    interpreter.interpreter_builder.options = interpreter.InterpreterOptions(sanitize_overflow=False)


def code_for_h100(d: int) -> str:
    """The kernel in the assembly language of NVIDIA; its last stage is compiled, too."""
    from triton.backends.compiler import GPUTarget
    from triton.compiler import ASTSource, compile

    from nilbs.fields.gpu_kernel import Blends, Bricks, Voxels, search_kernel

    pointers = {
        "voxels": Voxels("*fp32", "*i32", "*i32", "*fp32"),
        "blends": Blends("*fp32", "*i32", "*fp32"),
        "bricks": Bricks("*fp32", "*i32", "*i32", "*i64", "*i32", "*i16", "*fp32"),
    }
    signature = {"x": "*fp32", "n": "i32", "distance": "*fp32", "x_rest": "*fp32", **pointers}
    aligned = [(i,) for i in (0, 2, 3)] + [(4 + i, j) for i, of in enumerate(pointers.values()) for j in range(len(of))]
    source = ASTSource(
        search_kernel,
        {**signature, "D": "constexpr", "LANES": "constexpr"},
        {"D": d, "LANES": 32},
        {place: [["tt.divisibility", 16]] for place in aligned},
    )
    return compile(source, target=GPUTarget("cuda", 90, 32), options={"num_warps": 1}).asm["ptx"]


if __name__ == "__main__":
    if sys.argv[1].isdecimal():
        print(code_for_h100(int(sys.argv[1])))
    else:
        main(Path(sys.argv[1]))
