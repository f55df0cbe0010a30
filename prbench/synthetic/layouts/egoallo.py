"""EgoAllo's output files and the invented body model as files.

Sources: docs/specification/egoallo.md#files and docs/specification/egoallo.md#joints.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from prbench.readers.egoallo import format as ego
from prbench.skeleton import PARENTS
from prbench.storage import atomic_path, write_text
from prbench.synthetic.sensors.smplh import invented_smplh

_NO_PARENT = 2**32 - 1


def write_outputs(outputs: Sequence[ego.EgoAlloOutput], folder: Path) -> None:
    """Write output files, each with its ``_args.yaml``, into ``folder`` (a recording's ``egoallo_outputs``).

    Raises:
        StorageError: if the disk is full or the folder cannot be written.
    """
    for output in outputs:
        start, end = (int(part) for part in Path(output.name).stem.rpartition("_")[2].split("-"))
        samples, frames = output.world_from_root.shape[:2]
        straight = np.zeros((samples, frames, ego.N_HAND_QUATS, 4), dtype=np.float32)
        straight[..., 0] = 1.0
        with atomic_path(folder / output.name) as temporary:
            np.savez(
                temporary,
                **{
                    ego.WORLD_FROM_CPF: output.world_from_cpf,
                    ego.WORLD_FROM_ROOT: output.world_from_root,
                    ego.BODY_QUATS: output.body_quats,
                    ego.LEFT_HAND_QUATS: straight,
                    ego.RIGHT_HAND_QUATS: straight,
                    ego.CONTACTS: np.zeros((samples, frames, ego.N_BODY_QUATS), dtype=np.float32),
                    ego.BETAS: output.betas,
                    ego.FRAME_NUMS: np.arange(start, start + frames),
                    ego.TIMES: output.time_ns,
                },
            )
        write_text(
            folder / f"{Path(output.name).stem}{ego.ARGUMENTS_SUFFIX}",
            f"start_index: {start}\ntraj_length: {end - start}\nnum_samples: {samples}\n",
        )


def write_smplh_model(path: Path) -> None:
    """Write the invented body model with the keys of an SMPL-H file: 52 points, one a joint; fingers at the wrists.

    Raises:
        StorageError: if the disk is full or the folder cannot be written.
    """
    rest, n = invented_smplh(), ego.N_MODEL_JOINTS
    hands = np.repeat([20, 21], ego.N_HAND_QUATS)
    owner = np.concatenate([np.arange(22), hands])
    parents = np.concatenate([[_NO_PARENT], np.array(PARENTS[1:]), hands])
    with atomic_path(path) as temporary:
        np.savez(
            temporary,
            **{
                "f": np.array([[0, 1, 2]], dtype=np.int32),
                ego.REGRESSOR: np.eye(n),
                "kintree_table": np.stack([parents, np.arange(n)]).astype(np.uint32),
                "weights": np.eye(n),
                "posedirs": np.zeros((n, 3, 9 * (n - 1))),
                ego.TEMPLATE: rest.template[owner],
                ego.SHAPES: rest.directions[owner],
            },
        )
