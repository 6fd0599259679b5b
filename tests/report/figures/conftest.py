"""One made-up result for all tests of figures, and how they find a line."""

import h5py
import numpy as np
import pytest
from made_up_results import write_result

from rths_cli.files.result_reader import read_result


@pytest.fixture(scope="session")
def made_up(tmp_path_factory):
    """Return a complete result of a virtual table."""
    return read_result(write_result(tmp_path_factory.mktemp("figures") / "made_up.h5"))


@pytest.fixture(scope="session")
def data(made_up):
    """Return the file's own datasets by path."""
    found = {}
    with h5py.File(made_up.path) as file:
        file.visititems(lambda name, node: found.update({name: node[()]} if isinstance(node, h5py.Dataset) else {}))
    return found


@pytest.fixture
def line_of():
    """Return a function that finds the values of a line by colour among those of some axes."""

    def find(ax, color, number=0):
        drawn = [line for line in ax.lines if line.get_color() == color and np.size(line.get_xdata()) > 2]
        return np.asarray(drawn[number].get_xdata(), float), np.asarray(drawn[number].get_ydata(), float)

    return find
