from __future__ import annotations

from functools import partial
from pathlib import Path

import pytest

from uniforce_datasets.readers import GenForceConfig, force_set, pair_set, read_genforce
from uniforce_vtla.errors import DatasetError


def test_an_unknown_folder_lists_what_was_looked_for(tmp_path: Path) -> None:
    (tmp_path / "photos").mkdir()
    (tmp_path / "notes.txt").touch()
    with pytest.raises(DatasetError) as caught:
        force_set(tmp_path)
    for part in ("img/ and force/", "meta/info.json", "*.mcap", "*.h5", "notes.txt, photos/"):
        assert part in str(caught.value)


def test_an_empty_or_absent_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="an empty folder"):
        force_set(tmp_path)
    with pytest.raises(DatasetError, match="a folder, got none"):
        force_set(tmp_path / "absent")
    with pytest.raises(DatasetError, match="a folder, got none"):
        pair_set(tmp_path / "absent")


def test_two_formats_in_one_folder_are_refused(genforce: Path) -> None:
    (genforce / "run.mcap").touch()
    with pytest.raises(DatasetError, match=r"genforce and taf_mcap.*one data set"):
        force_set(genforce)


def test_a_reader_with_settings_can_be_given(genforce: Path) -> None:
    chosen = force_set(genforce, partial(read_genforce, config=GenForceConfig(split="unseen")))
    assert {r.indenter for r in chosen} == {"wave"} and len(list(chosen)) == 3
