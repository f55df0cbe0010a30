"""Map import names to folders: what pyproject.toml cannot say for wheels, sdists and editable installs alike."""

import re
from pathlib import Path

from setuptools import find_packages, setup

FOLDERS = {
    "prbench": "prbench",
    "prbench_adapters": "adapters",
    "prbench_benchmarks": "benchmarks",
    "prbench_data_manifests": "data_manifests",
}
DATA = [
    "*.toml",
    "*.csv",
    "*.json",
    "*.safetensors",
    "*.template",
    "dataset/**/*.template",
    "*.html",
    "*.css",
    "*.js",
    "*.mplstyle",
    "vendor/*/*",
    "assets/*",
    "LICENSE",
    "*.pyi",
    "py.typed",
    "splits/*.csv",
    "weights/*.json",
    "weights/*.safetensors",
]
NOT_SHIPPED = [
    "choices",
    "looking",
    "speed",
    "speed.*",
    "statistics",
    "statistics.*",
]  # programs of use only beside the source

packages = [
    name
    for package, folder in FOLDERS.items()
    for name in (package, *(f"{package}.{sub}" for sub in find_packages(folder, exclude=NOT_SHIPPED)))
]
version = re.search(r"^## (\d+\.\d+\.\d+)", Path(__file__).with_name("CHANGELOG.md").read_text("utf-8"), re.MULTILINE)

setup(
    version=version.group(1),
    packages=packages,
    package_dir=FOLDERS,
    package_data=dict.fromkeys(packages, DATA),
)
