"""The 22 joints of SMPL parameters without the package ``smplx``, from the user's own SMPL, SMPL-H or SMPL-X file.

Body models are licensed and never shipped. The 22 joints need three arrays of one, which are read from plain arrays and
never from a pickle: the rest joints are a linear function of the shape,
``J_regressor @ (v_template + shapedirs @ betas)``. Forward kinematics in NumPy moves them.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from prbench.errors import InputFileError
from prbench.files.arrays import Archive
from prbench.files.bounded import foreign_input
from prbench.geometry.skeleton import N_JOINTS, PARENTS, Joint
from prbench.representation.converters.smpl_parameters import SmplParameters
from prbench.representation.converters.smpl_rotations import to_matrices

REGRESSOR = "J_regressor"
TEMPLATE = "v_template"
SHAPES = "shapedirs"
SMPL_JOINTS = 24
SMPLH_JOINTS = 52
SMPLX_JOINTS = 55
"""Rows of the regressor, by which the three models are told apart."""

HOW_TO_CONVERT = (
    "prbench opens no pickles. Convert the licensed file once, in the environment of its own tools (a .pkl of SMPL"
    " needs chumpy there): python -c \"import numpy, pickle, sys; m = pickle.load(open(sys.argv[1], 'rb'),"
    " encoding='latin1'); numpy.savez(sys.argv[2], **{k: numpy.asarray(v.todense() if hasattr(v, 'todense') else v)"
    " for k, v in m.items() if k in ('J_regressor', 'v_template', 'shapedirs', 'posedirs', 'weights', 'f',"
    " 'kintree_table', 'hands_componentsl', 'hands_componentsr', 'hands_meanl', 'hands_meanr', 'lmk_faces_idx',"
    " 'lmk_bary_coords')})\" MODEL.pkl MODEL.npz"
)


@dataclass(frozen=True)
class RestJoints:
    """The 22 joints of a body model in its rest pose, linear in the shape. Model frame: x left, y up, z forward."""

    template: Float[np.ndarray, "22 3"]
    """Rest joints of the mean shape, metres."""
    directions: Float[np.ndarray, "22 3 shapes"]
    """Displacements that each shape number adds, metres."""

    def of(self, betas: Float[np.ndarray, " shapes"] | None) -> Float[np.ndarray, "22 3"]:
        """Rest joints of one shape, metres; fewer numbers than the model has leave the others at 0.

        Raises:
            InputFileError: if there are more shape numbers than the model knows.
        """
        if betas is None:
            return self.template
        known = self.directions.shape[-1]
        if len(betas) > known:
            if np.any(betas[known:]):
                raise InputFileError(
                    "betas",
                    "",
                    expected=f"at most the {known} shape numbers of the body model",
                    found=str(len(betas)),
                    remedy="The shape belongs to another model (SMPL-H 'extended' has 16); take the model that it was"
                    " fitted with.",
                )
            betas = betas[:known]
        return self.template + self.directions[..., : len(betas)] @ betas.astype(np.float64)

    @classmethod
    def fixed(cls, joints: Float[np.ndarray, "22 3"]) -> RestJoints:
        """Rest joints that are known without any model file: T-pose joints of the one body that a method knows."""
        return cls(joints.astype(np.float64), np.zeros((N_JOINTS, 3, 0)))


@foreign_input()
def read_rest_joints(path: Path) -> RestJoints:
    """The rest joints of a body model in ``.npz`` form.

    Args:
        path: ``SMPLX_NEUTRAL.npz``, ``smplh/neutral/model.npz``, or what :data:`HOW_TO_CONVERT` writes.

    Raises:
        InputFileError: if the file is missing, a pickle, no archive of plain arrays, or its arrays do not fit together.
    """
    arrays = read_plain_arrays(path, (REGRESSOR, TEMPLATE, SHAPES))
    regressor, template, shapes = (arrays[key].astype(np.float64) for key in (REGRESSOR, TEMPLATE, SHAPES))
    points = len(template)
    fits = (
        template.shape == (points, 3)
        and regressor.ndim == 2
        and regressor.shape[0] >= N_JOINTS
        and regressor.shape[1] == points
        and shapes.ndim == 3
        and shapes.shape[:2] == (points, 3)
    )
    if not fits or not all(np.isfinite(array).all() for array in (regressor, template, shapes)):
        raise InputFileError(
            path,
            "",
            expected=f"finite v_template (v, 3), J_regressor (at least {N_JOINTS}, v) and shapedirs (v, 3, shapes)",
            found=f"{template.shape}, {regressor.shape} and {shapes.shape}",
            remedy="This is the model of another body.",
        )
    body = regressor[:N_JOINTS]
    shapes = shapes[..., : _shape_numbers(regressor.shape[0], shapes.shape[2])]
    return RestJoints(body @ template, np.einsum("jv,vck->jck", body, shapes))


def _shape_numbers(joints: int, columns: int) -> int:
    """Columns of ``shapedirs`` that are shape: in SMPL-X those of the face's expression follow them."""
    if joints != SMPLX_JOINTS:
        return columns
    return 300 if columns >= 400 else min(columns, 10)


@foreign_input()
def read_plain_arrays(path: Path, needed: Iterable[str], optional: Iterable[str] = ()) -> dict[str, np.ndarray]:
    """Arrays of a body model by name; those that hold Python objects are never opened.

    Raises:
        InputFileError: if the file is missing, a pickle, or lacks one of the needed arrays.
    """
    path = path.expanduser()
    if not path.exists():
        raise InputFileError(
            path,
            "",
            expected="your own body model",
            found="no such file",
            remedy="Download it from the page of the model (smpl.is.tue.mpg.de, mano.is.tue.mpg.de,"
            " smpl-x.is.tue.mpg.de) after accepting its licence; prbench ships none.",
        )
    if path.suffix == ".pkl":
        raise InputFileError(path, "", expected="an .npz archive", found="a pickle", remedy=HOW_TO_CONVERT)
    needed = tuple(needed)
    archive = Archive(path, remedy=HOW_TO_CONVERT)
    archive.require(needed)
    return archive.load((*needed, *optional))


def smpl_joints(parameters: SmplParameters, rest: RestJoints) -> Float[np.ndarray, "frames 22 3"]:
    """Joints as the body model has them; blend shapes of the surface move none of them, so this is exact.

    SMPL, SMPL-H and SMPL-X share the order of these 22 joints, not their rest joints: take the model that the
    parameters were made for.

    Args:
        parameters: The motion.
        rest: Rest joints of the model.

    Returns:
        World of the parameters (AMASS: Z up), metres, at their rate.

    Raises:
        InputFileError: if there are more shape numbers than the model knows.
    """
    body = rest.of(parameters.betas)
    local = to_matrices(parameters.rotations)
    world = [local[:, Joint.PELVIS]]
    joints = [parameters.transl + body[Joint.PELVIS]]
    for joint in range(1, N_JOINTS):
        parent = PARENTS[joint]
        joints.append(joints[parent] + world[parent] @ (body[joint] - body[parent]))
        world.append(world[parent] @ local[:, joint])
    return np.stack(joints, axis=1)
