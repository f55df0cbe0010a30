"""The environment of an isolated method: an allow-list, in which nothing leads to data."""

from __future__ import annotations

from pathlib import Path

from prbench.harness.methods.isolation import isolated_environment, readable_folders, text_encoder


def test_what_leads_to_data_or_to_the_user_is_withheld_and_what_computing_needs_is_kept(tmp_path):
    kept = {"PATH": "/bin", "LC_ALL": "C", "CUDA_VISIBLE_DEVICES": "1", "OMP_NUM_THREADS": "2", "SystemRoot": "C:"}
    withheld = {
        "HOME": "/home/me", "PWD": "/data", "OLDPWD": "/data", "USER": "me", "PRBENCH_CACHE": "c", "HF_TOKEN": "t",
        "ADT_ROOT": "/data/adt", "SSH_AUTH_SOCK": "s", "PYTHONPATH": "/x", "prbench_samples": "s", "VIRTUAL_ENV": "v",
    }  # fmt: skip
    assert isolated_environment({**kept, **withheld, "XDG_CACHE_HOME": str(tmp_path)}) == kept


def test_model_caches_are_named_where_they_exist_because_there_is_no_home_to_find_them_in(tmp_path):
    (tmp_path / "huggingface").mkdir()
    found = isolated_environment({"XDG_CACHE_HOME": str(tmp_path)})
    assert found == {"HF_HOME": str(tmp_path / "huggingface")}
    assert readable_folders(found) == (tmp_path / "huggingface",)
    assert isolated_environment({"XDG_CACHE_HOME": str(tmp_path), "HF_HOME": "/m"}) == {"HF_HOME": "/m"}


def test_the_text_encoders_of_our_own_models_are_the_only_variables_of_prbench_that_are_passed_on(tmp_path):
    user = {"PRBENCH_DISTILBERT": str(tmp_path), "PRBENCH_CACHE": "c"}
    assert text_encoder(user) == {"PRBENCH_DISTILBERT": str(tmp_path)}
    assert readable_folders(user) == (Path(tmp_path),)
    assert text_encoder({"PRBENCH_CLIP": str(tmp_path)}) == {"PRBENCH_CLIP": str(tmp_path)}
    assert readable_folders({"PRBENCH_CLIP": str(tmp_path)}) == (Path(tmp_path),)
    assert text_encoder({}) == {}
