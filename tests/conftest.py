"""The order of tests: the files that take longest come first, so that no worker is left with one of them at the end."""

import pytest

LONG = (
    "tests/test_notebooks.py",
    "tests/contracts/test_methods.py",
    "tests/data_gen/test_skips.py",
    "tests/data_gen/test_translucent_methods.py",
    "tests/stability/test_cases.py",
    "tests/methods/test_streamed.py",
    "tests/runtime/test_glossy.py",
    "tests/modular/test_joined.py",
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files of `LONG` by their order there, then all others as they were."""
    items.sort(key=lambda item: next((at for at, name in enumerate(LONG) if item.nodeid.startswith(name)), len(LONG)))
