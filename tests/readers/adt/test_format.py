from __future__ import annotations

import numpy as np

from prbench.protocol.manifests import load_manifest
from prbench.readers.adt import format as adt


def test_the_manifest_s_mapping_is_the_list_of_the_page() -> None:
    listed = [0, 43, 47, 1, 44, 48, None, 45, 49, 2, 46, 50, 3, 5, 24, 4, 6, 25, 7, 26, 8, 27]
    native = np.arange(51, dtype=float)[None, :, None] * np.ones(3)
    mapped = adt.body_joints(native, load_manifest("adt").body.joint_mapping)[0, :, 0]
    assert mapped.tolist() == [1.5 if index is None else index for index in listed]


def test_named_contact_joints_have_the_documented_numbers() -> None:
    assert adt.N_NATIVE_JOINTS == 51
    assert adt.WRIST_JOINTS == (8, 27)
    assert adt.MIDDLE_FINGER_BASES == (15, 34)


def test_doors_and_drawers_are_told_by_category_or_name() -> None:
    assert adt.is_hinged("Apartment_BedroomDoor", "door")
    assert adt.is_hinged("Apartment_CabinetDrawerF", "part of a cabinet/wardrobe")
    assert adt.is_hinged("OfficeDrawer_2", "cabinets and shelves")
    for name, category in (
        ("WoodenBowl", "bowl"),
        ("UtilityCart", "cabinets and shelves"),
        ("IndoorPlant", "house plant"),
    ):
        assert not adt.is_hinged(name, category)
