"""Every conversion once, on any namespace of converters: prbench's own, or the one file of an old Python.

Run as ``python calculations.py GIVEN.npz FOUND.npz`` beside ``prbench_converters.py``. Plain Python 3.8.
"""

import sys

import numpy as np

ROTATIONS = ("axis-angle", "matrix", "quaternion-wxyz", "quaternion-xyzw", "6d-columns", "6d-rows", "6d-interleaved")


def calculated(c, given):
    """Results by name; `c` has the converters, `given` the arrays."""
    features, initial, body = given["features"], given["initial"], given["body"]
    rows = len(features)
    found = {}
    found["positions"] = c.joints_from_features(features, rows + 1)
    found["rest"] = c.rest_offsets(initial)
    found["absolute"] = c.joints_from_features(given["absolute"], root="absolute")
    statistics = c.Statistics(given["mean"], given["std"])
    output = given["standardised"].T[None, :, None]
    restored = statistics.restore(c.feature_rows(output))
    found["restored"] = c.motions_from_features(restored, [rows - 5], source="m", sequences=["s"])[0]
    own = c.on_body_of(found["positions"], initial)
    found["placed"] = c.placed_on(own, initial)
    found["on the floor"] = c.placed_on(own, initial, height="floor")
    found["padded"] = c.padded([own, own[:7]])
    found["frame of"] = c.in_frame_of(own, own[10:20])
    uniform = c.UniformSkeleton.of(np.stack([initial, 1.1 * initial]))
    found["uniform goals"] = uniform.locations(np.array([[1.0, 0.5, 2.0], [0.3, 0.2, 0.1]]))
    found["uniform poses"] = uniform.poses(np.stack([initial, initial]))
    found["canonical"] = c.to_canonical(given["foreign"], 30.0, n_frames=20, up="z", unit="mm", left_handed=True)
    found["at times"] = c.at_times(given["times"], body, n_frames=15)
    found["z up and back"] = c.y_up(c.z_up(body) * 2)
    rest = c.RestJoints.fixed(given["rest"])
    for form in ROTATIONS:
        values = given[form]
        parameters = c.SmplParameters.from_poses(values, given["transl"], form=form)
        found["quaternions, " + form] = parameters.rotations
        found["smpl, " + form] = c.smpl_joints(parameters, rest)
    for name, map_ in c.JOINT_MAPS.items():
        found["map " + name] = map_.to_22(given["joints " + name])
    by_names = c.joint_map_by_names(["mixamorig:" + name for name in c.JOINT_MAPS["mixamo"].source_joints])
    found["by names"] = by_names.to_22(given["joints mixamo"])
    found["noise"] = c.sequence_generator(2**62 + 5).normal(size=4)
    for seed in (5, 2**62 + 5):
        with c.sequence_noise(seed):
            found[f"global noise {seed}"] = np.random.normal(size=4)  # noqa: NPY002
    return found


def refusals(c, given):
    """What is refused, in words."""
    wrong = given["features"].copy()
    wrong[:, 1:3] *= 30
    said = []
    for call in (
        lambda: c.motions_from_features([wrong] * 4, [20] * 4, source="glide", sequences="abcd"),
        lambda: c.joint_map("mixamoo"),
        lambda: c.to_canonical(given["body"] * 1000, 20.0),
    ):
        try:
            call()
        except c.PrbenchError as error:
            said.append(str(error))
    return said


if __name__ == "__main__":
    import prbench_converters

    with np.load(sys.argv[1]) as file:
        arrays = dict(file)
    results = calculated(prbench_converters, arrays)
    np.savez(sys.argv[2], __said__=np.array(refusals(prbench_converters, arrays)), **results)
