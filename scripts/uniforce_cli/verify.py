"""Check that a dataset or view is as it was saved; renew hashes after LeRobot's own tools."""

from dataclasses import dataclass
from pathlib import Path

from uniforce_cli.boundary import Verify, command
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.keys import VIEW_MARKER
from uniforce_vtla.options import FolderPath


@dataclass
class VerifyConfig:
    """Check files, frames and numbers of a recorded dataset or training view against its hashes.

    Example: uniforce verify root=outputs/demos verify=full
    After lerobot-edit-dataset and the like: uniforce verify root=outputs/demos rehash=true
    """

    root: FolderPath = "outputs/demos"  # folder of a recorded dataset or training view
    # full = every byte and frame | quick = sizes, small files, some frames of every episode
    verify: Verify = "full"
    # check the content only, then pool the statistics and write the hashes of the files as they are
    rehash: bool = False


def verify(config: VerifyConfig) -> str:
    """Return a line about a dataset or view that is whole.

    Raises DatasetError: something isn't as it was saved, or its content can't be trusted;
    ContractError: another ``verify``; a view, which is built again instead of hashed again.
    """
    if config.verify == "off":
        do = "Choose how much is compared."
        raise ContractError(expected("verify", "full or quick", "off", do))
    from uniforce_datasets.hashes import check_hashes
    from uniforce_datasets.lossless import check_dataset, rehash
    from uniforce_datasets.view_plan import read_marker
    from uniforce_vtla.file_hashes import HASHES

    root = Path(config.root)
    if (root / VIEW_MARKER).is_file():
        if config.rehash:
            do = "Build the view again with uniforce view."
            raise ContractError(expected("rehash", "false for a training view", "true", do))
        marker = read_marker(root)
        check_hashes(root)
        return f"{root}: view of {len(marker['episodes'])} episodes, as it was built"
    if config.rehash:
        source = rehash(root, config.verify)
        done = "content checked, hashes written"
    else:
        source = check_dataset(root, config.verify)
        done = "as it was saved"
        if not (source.root / HASHES).is_file():
            done = "content checked; it has no hashes to compare with"
    found = f"{len(source.episodes)} episodes, {source.num_frames} frames"
    return f"{root}: {found}, {done} ({config.verify})"


@command(VerifyConfig)
def main(config: VerifyConfig) -> None:
    print(verify(config))
