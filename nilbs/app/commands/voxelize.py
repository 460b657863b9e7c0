"""`nilbs voxelize`: occupancy or distance of a posed model on a regular grid."""

import argparse

from nilbs.app.options import add_json, add_pose, add_resolution, positive

# Nodes that are queried at once, and the most of a grid.
CHUNK, MOST = 2**20, 2**30

EXAMPLE = "nilbs voxelize hero.nilbs --frame 12 -o grid.npz"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    parser.add_argument("model", metavar="MODEL", help="a trained model, .nilbs")
    add_pose(parser)
    parser.add_argument(
        "--quantity",
        choices=("occupancy", "distance"),
        default="occupancy",
        help="1 inside and 0 outside, or the signed distance to the posed skin, in mesh units (default occupancy)",
    )
    add_resolution(parser)
    parser.add_argument(
        "--spacing", type=positive, metavar="H", help="between nodes, in mesh units; in place of --resolution"
    )
    parser.add_argument(
        "-o",
        "--output",
        metavar="FILE",
        required=True,
        help="arrays to write, .npz: values of the nodes, whose first index is x; origin, the first node, and spacing, "
        "in mesh units; or a volume in space, .vdb (OpenVDB)",
    )
    add_json(parser)


def run(args: argparse.Namespace) -> None:
    """Evaluate, write and report."""
    import numpy as np

    from nilbs.app.output import show
    from nilbs.app.poses import chosen_pose
    from nilbs.geometry.grids import Grid
    from nilbs.geometry.progress import progress_bar
    from nilbs.io import check_suffix, check_writable, write_npz
    from nilbs.io.vdb import write_vdb
    from nilbs.models.model import load_model

    suffix = check_suffix(args.output, ".npz", ".vdb")
    check_writable(args.output)
    model = load_model(args.model)
    if suffix == ".vdb" and model.character.d == 2:
        raise ValueError(f"{args.output}: this model is flat, and .vdb holds volumes in space: choose .npz")
    posed = model.posed(chosen_pose(model, args))
    grid = Grid.box(posed.U, args.resolution)
    if args.spacing is not None:
        lower = np.floor(grid.lower / args.spacing)  # nodes are multiples of the spacing, whatever the pose
        nodes = np.ceil(grid.upper / args.spacing) - lower + 1
        if not nodes.prod() <= MOST:
            raise ValueError(f"--spacing {args.spacing:g} makes {nodes.prod():.3g} nodes, more than {MOST:.3g}")
        grid = Grid(lower * args.spacing, args.spacing, tuple(int(n) for n in nodes))
    if grid.size > MOST:
        raise ValueError(f"--resolution {args.resolution} makes {grid.size:.3g} nodes, more than {MOST:.3g}")
    values = np.empty(grid.size, dtype=np.uint8 if args.quantity == "occupancy" else np.float32)
    inside = 0
    with progress_bar(total=grid.size, desc="voxels", unit="node", unit_scale=True) as bar:
        for part, x in grid.chunks(CHUNK):
            found = posed.occupancy(x) > 0.5 if args.quantity == "occupancy" else posed.posed_distance(x)
            values[part] = found
            inside += int(np.count_nonzero(found if args.quantity == "occupancy" else found < 0))
            bar.update(len(x))
    A = values.reshape(grid.shape)
    if suffix == ".npz":
        write_npz(args.output, {"values": A, "origin": grid.origin, "spacing": np.array(grid.spacing)})
    else:
        level_set = args.quantity == "distance"
        about: dict[str, str | int | float] = {"spacing": grid.spacing, "unit": "mesh units"}
        about |= {"character": model.character.name, "creator": "nilbs"}
        about |= {"frame": args.frame} if args.time is None else {"time": args.time}
        write_vdb(
            args.output, A, origin=grid.origin, spacing=grid.spacing, name=args.quantity,
            background=float(A.max()) if level_set else 0.0, metadata=about, level_set=level_set,
        )  # fmt: skip
    report = {
        "nodes": " x ".join(map(str, grid.shape)),
        "spacing": grid.spacing,
        "quantity": args.quantity,
        "inside": inside,
        "volume": inside * grid.spacing**model.character.d,
        "output": args.output,
    }
    show(report, as_json=args.json)
