"""Turn the public checkpoints of GMD, which a user has downloaded, into weights of prbench.

``python -m prbench_adapters.gmd.import_public --help`` says what is needed; ``docs/methods/gmd.md`` where it is found.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from prbench.errors import PrbenchError

_EXAMPLE = """\
example, in a clone of the original's repository with both checkpoints unpacked in save/:
  python -m prbench_adapters.gmd.import_public \\
    --motion save/unet_adazero_xl_x0_abs_proj10_fp16_clipwd_224/model000500000.pt \\
    --trajectory save/traj_unet_adazero_swxs_eps_abs_fp16_clipwd_224/model000062500.pt \\
    --statistics dataset/HumanML3D_abs/Mean_abs_3d.npy dataset/HumanML3D_abs/Std_abs_3d.npy \\
    --projection dataset/rand_proj.npy --out gmd-public.safetensors
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Import, and say what was found.

    Returns:
        0 on success; the ``exit_code`` of a :class:`PrbenchError`; 130 after Ctrl-C.
    """
    parser = argparse.ArgumentParser(
        prog="python -m prbench_adapters.gmd.import_public",
        description="Turn the public checkpoints of GMD into weights for `prbench run --method gmd`. No code that a"
        " file might hold is run.",
        epilog=_EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = partial(parser.add_argument, type=Path, required=True)
    add("--motion", metavar="FILE.pt", help="checkpoint of the motion model")
    add("--trajectory", metavar="FILE.pt", help="checkpoint of the trajectory model")
    add("--statistics", nargs=2, metavar=("MEAN.npy", "STD.npy"), help="of the features with an absolute root")
    add("--projection", metavar="FILE.npy", help="the emphasis projection, not its inverse")
    add("--out", metavar="FILE.safetensors", help="the weights to write")
    given = parser.parse_args(arguments)
    try:
        from prbench_adapters.gmd.public_weights import PublicFiles, import_public  # late: torch

        mean, std = given.statistics
        imported = import_public(PublicFiles(given.motion, given.trajectory, mean, std, given.projection), given.out)
    except PrbenchError as error:
        print(f"import_public: {error}", file=sys.stderr)  # noqa: T201 - a command
        return error.exit_code
    except KeyboardInterrupt:
        print("import_public: interrupted; nothing was written.", file=sys.stderr)  # noqa: T201
        return 130
    out = given.out
    sizes = imported.configuration
    lines = [
        f"motion network: {', '.join(map(str, sizes.motion_widths))} channels, copy '{imported.copies['motion']}'",
        f"trajectory network: {', '.join(map(str, sizes.trajectory_widths))} channels,"
        f" copy '{imported.copies['trajectory']}'",
        *(f"{path}: not the file of the public repository; used as it is" for path in imported.not_released),
        f"{out}: {imported.parameters / 1e6:.1f} million parameters, {out.stat().st_size / 1e6:.0f} MB;"
        f" {out.with_suffix('.json').name} says where they come from",
        f"next: prbench run --method gmd --condition goal-pose --weights {out}",
    ]
    print("\n".join(lines))  # noqa: T201
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
