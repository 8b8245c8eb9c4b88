"""``monoloc signature``: say who made a bundle or a place, and check it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from monoloc.bundle import read_bundle
from monoloc.bundle_manifest import manifest_content
from monoloc.bundle_signature import SIGNATURE, make_keys, signature_of
from monoloc.cli.common import JsonOption, print_json, stderr
from monoloc.cli.output_checks import check_apart
from monoloc.errors import BundleError
from monoloc.partial_files import whole_file
from monoloc.place.flown_map import is_place
from monoloc.place.place_files import read_place
from monoloc.place.place_manifest import place_content

app = typer.Typer(
    help="Sign bundles and places, and check them.",
    no_args_is_help=True,
    rich_markup_mode=None,
)
BundleArgument = Annotated[
    Path, typer.Argument(metavar="BUNDLE", help="Bundle from monoloc build, or place from monoloc place.")
]
RequireSignatureOption = Annotated[
    Path | None,
    typer.Option(
        "--require-signature", metavar="KEY.pub", help="Refuse bundles that the owner of this key has not signed."
    ),
]


@app.command()
def keys(
    name: Annotated[str, typer.Argument(metavar="NAME", help="NAME.key and NAME.pub are written.")],
    json: JsonOption = False,
) -> None:
    """Make a pair of keys: a secret one to sign with, and one to check with.

    \b
    Examples:
      monoloc signature keys team        (writes team.key and team.pub)
    """
    private, public = Path(f"{name}.key"), Path(f"{name}.pub")
    check_apart(private, "NAME", ())
    make_keys(private, public)
    stderr.print(f"written: {private} (keep it secret) and {public}", soft_wrap=True)
    if json:
        print_json({"private_key": str(private), "public_key": str(public)})


@app.command()
def sign(
    bundle: BundleArgument,
    key: Annotated[Path, typer.Option("--key", metavar="NAME.key", help="Private key.")],
    json: JsonOption = False,
) -> None:
    """Sign a bundle, after a check of every byte, or a place.

    Any later change, or build of the same name, voids the signature. The bundles of a place are signed one by one.
    The signature of a place covers its doors, and which bundles it consists of.

    \b
    Examples:
      monoloc signature sign kitchen.monoloc --key team.key
      monoloc signature sign house.place --key team.key
    """
    check_apart(key, "--key", (bundle,))
    manifest = place_content(bundle) if is_place(bundle) else manifest_content(bundle)
    _read(bundle)
    signature = signature_of(manifest, key)
    try:
        with whole_file(bundle.resolve() / SIGNATURE) as partial:
            partial.write_bytes(signature)
    except OSError as error:
        fix = "sign a copy that you can write to"
        raise BundleError(bundle, f"cannot be written to ({error.strerror})", fix) from error
    stderr.print(f"written: {bundle / SIGNATURE}", soft_wrap=True)
    if json:
        print_json({"bundle": str(bundle), "signature": str(bundle / SIGNATURE)})


@app.command()
def verify(
    bundle: BundleArgument,
    key: Annotated[Path, typer.Option("--key", metavar="NAME.pub", help="Public key of the expected signer.")],
    json: JsonOption = False,
) -> None:
    """Check that a bundle, or a place with all its bundles, is exactly what the owner of a key signed.

    \b
    Examples:
      monoloc signature verify kitchen.monoloc --key team.pub
    """
    _read(bundle, key)
    stderr.print(f"{bundle}: signed with the key of {key}", soft_wrap=True)
    if json:
        print_json({"bundle": str(bundle), "public_key": str(key)})


def _read(path: Path, public_key: Path | None = None) -> None:
    """Read a bundle or a place whole; raises as these readers do."""
    if is_place(path):
        read_place(path, public_key)
    else:
        read_bundle(path, public_key)
