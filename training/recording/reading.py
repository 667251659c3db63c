"""What a run has left in its folder, read back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load_file

from conf import Config, ConfigError, from_yaml, weight_shapes
from env.texts import read_text


def read_weights(folder: Path, config: Config) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """The online weights that a run has written: robots (K, P) and access point (P_AP,).

    Raises:
        ConfigError: they are missing, damaged or of another size than the configuration's.
    """
    path = folder / "weights.safetensors"
    try:
        arrays = load_file(path)
    except FileNotFoundError as error:
        raise ConfigError(f"{path} is missing: has the run ended?") from error
    except SafetensorError as error:
        raise ConfigError(f"{path} is damaged: {error}.") from error
    except OSError as error:
        raise ConfigError(f"{path} cannot be read: {error.strerror or error}.") from error
    for name, shape in weight_shapes(config).items():
        if name not in arrays or arrays[name].shape != shape:
            found = arrays[name].shape if name in arrays else "nothing"
            raise ConfigError(f"{path}: {name} is {found} where config.yaml says {shape}.")
    return arrays["robots"][:, 0], arrays["ap"][0]


def read_config(folder: Path) -> Config:
    """The configuration that a run has written.

    Raises:
        ConfigError: it is not there, or wrong.
    """
    path = folder / "config.yaml"
    try:
        return from_yaml(read_text(path))
    except UnicodeError as error:
        raise ConfigError(f"{path} cannot be read: {error}.") from error
    except OSError as error:
        raise ConfigError(f"{folder} is no run folder: {path.name} cannot be read.") from error
