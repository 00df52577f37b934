"""Options of the test run, and a cache of compiled libraries that is not the user's."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

# Its assertions tell values like those of the test files.
pytest.register_assert_rewrite("helpers", "scenes")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--update-golden", action="store_true", help="rewrite the specimens under generated/"
    )


@pytest.fixture(autouse=True, scope="session")
def library_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Compiled libraries of the tests go to a folder of their own."""
    folder = tmp_path_factory.mktemp("libraries")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RBSD_SYM_CACHE", str(folder))
        yield folder


# Batteries of hundreds of cases: an ordinary run takes every third one, `-m ""` all of them.
_LONG = (
    "test_effects", "test_effects_contact", "test_effects_friction", "test_effects_materials",
    "test_events", "test_events_cascades", "test_events_hidden",
    "test_generalized_alpha", "test_generalized_alpha_steps", "test_data_states",
    "test_data_states_forms", "test_active", "test_unknown_instructions",
)  # fmt: skip


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for name in _LONG:
        battery = [item for item in items if item.path.stem == name]
        for i, item in enumerate(battery):
            if i % 3:
                item.add_marker(pytest.mark.slow)
