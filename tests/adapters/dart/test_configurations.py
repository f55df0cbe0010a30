"""The committed training configurations: complete, consistent, and what the original says."""

from __future__ import annotations

from importlib import resources

import pytest

from prbench.harness.methods.installed import list_tasks, load_task
from prbench_adapters.dart.model import DartConfiguration, LatentDenoiser, PrimitiveVAE
from prbench_adapters.dart.training import DartTask, Objective, read_model_table
from prbench_adapters.training.configuration import TrainingConfiguration, list_configurations, load_configuration

PACKAGE = "prbench_adapters.dart"


def _load(name: str, stage: str) -> TrainingConfiguration:
    return load_configuration(name, package=PACKAGE, task="dart", stage=stage)


def test_the_method_is_trainable_by_its_one_line():
    assert "dart" in list_tasks()
    assert isinstance(load_task("dart"), DartTask)
    assert list_configurations(PACKAGE, "dart") == ("paper", "small", "smoke")


def test_the_paper_configuration_holds_the_numbers_of_the_original():
    """docs/specification/dart.md#networks and docs/specification/dart.md#training."""
    configuration = _load("paper", "pretrain")
    model, objective = read_model_table(configuration.model)
    assert model == DartConfiguration()  # the defaults are the original's sizes
    assert objective == Objective(vae_batch_size=128, denoiser_stages=(0.3334, 0.3333, 0.3333))  # and its weights
    training = configuration.training
    assert (training.steps, training.batch_size, training.learning_rate) == (500_000, 1024, 1e-4)
    assert (training.ema, training.gradient_clip) == (0.999, 1.0)
    assert round(objective.vae_share * training.steps) == 200_000
    stages = [round(share * 200_000) for share in objective.vae_stages]
    assert stages == [100_000, 50_000, 50_000]


def test_the_paper_networks_have_the_originals_size():
    """12.4 and 18.0 million with CLIP's 512 numbers a text; the VAE's 500 positions are 12 and 11 here."""
    model = DartConfiguration(text_dimension=512)
    vae, denoiser = (sum(p.numel() for p in network(model).parameters()) for network in (PrimitiveVAE, LatentDenoiser))
    assert vae + (1000 - 12 - 11) * 256 == pytest.approx(12.4e6, rel=0.005)
    assert denoiser == pytest.approx(18.0e6, rel=0.005)


def test_paper_windows_are_cropped_to_exactly_what_they_take():
    configuration = _load("paper", "pretrain")
    model, objective = read_model_table(configuration.model)
    assert configuration.data.max_frames == 2 + objective.primitives * model.future_frames


def test_small_networks_fit_the_package_as_float16():
    model, _ = read_model_table(_load("small", "finetune").model)
    parameters = sum(p.numel() for network in (PrimitiveVAE, LatentDenoiser) for p in network(model).parameters())
    assert parameters > 0.9e6
    assert 2 * parameters < 2.4e6  # bytes
    assert model.text_encoder == "hashed-ngrams"  # nothing to download


def test_every_number_of_the_paper_configuration_names_its_source():
    for line in resources.files(PACKAGE).joinpath("dart-paper.toml").read_text(encoding="utf-8").splitlines():
        key, _, value = line.partition("=")
        bookkeeping = key.strip() in {"mode", "save_every", "log_every", "sequences"}
        if value and not line.startswith("#") and not bookkeeping:
            assert any(word in line.partition("#")[2] for word in ("paper", "DART", "choice", "DistilBERT")), line
