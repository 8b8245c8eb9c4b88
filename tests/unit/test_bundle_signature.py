"""Signatures of bundles: they tell who made one, and a wrong one never stays."""

from __future__ import annotations

import shutil
import stat
import subprocess
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
from cryptography.hazmat.primitives import serialization as forms
from cryptography.hazmat.primitives.asymmetric import ed25519, rsa

from cli_helpers import json_of, outputs, refused, write_workspace
from monoloc.bundle import read_bundle, write_bundle
from monoloc.bundle_manifest import manifest_content
from monoloc.bundle_signature import SIGNATURE, make_keys, signature_of
from monoloc.cli.main import invoke
from monoloc.errors import MissingExtraError
from monoloc.flight.flight_file import read_flight_file
from refusals import refuses, refuses_data
from synthetic_room import SMALL_CAMERA, Room, RoomRecording, make_path

Capture = pytest.CaptureFixture[str]
ENCRYPTED = ed25519.Ed25519PrivateKey.generate().private_bytes(
    forms.Encoding.PEM, forms.PrivateFormat.PKCS8, forms.BestAvailableEncryption(b"secret")
)
RSA = (
    rsa.generate_private_key(65537, 1024)
    .public_key()
    .public_bytes(forms.Encoding.PEM, forms.PublicFormat.SubjectPublicKeyInfo)
)


@pytest.fixture(scope="module")
def signed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a recording, two pairs of keys, and a signed bundle."""
    folder = tmp_path_factory.mktemp("signed")
    write_workspace(folder, RoomRecording(Room(), make_path(4), SMALL_CAMERA), 40)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert invoke(["signature", "keys", "team"]) == invoke(["signature", "keys", "other"]) == 0
        assert invoke(["signature", "sign", "room.monoloc", "--key", "team.key"]) == 0
    return folder


@pytest.fixture
def here(signed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    shutil.copytree(signed, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def resigned_by(folder: Path, key: str) -> None:
    assert invoke(["signature", "sign", str(folder / "room.monoloc"), "--key", str(folder / key)]) == 0


def test_a_signed_bundle_is_verified_and_read_as_before(capfd: Capture, here: Path) -> None:
    assert (
        "signed with the key of team.pub"
        in outputs(capfd, "signature", "verify", "room.monoloc", "--key", "team.pub")[1]
    )
    content = json_of(capfd, "signature", "verify", "room.monoloc", "--key", "team.pub")
    assert content == {"bundle": "room.monoloc", "public_key": "team.pub"}
    content = json_of(capfd, "signature", "sign", "room.monoloc", "--key", "team.key")
    assert content == {"bundle": "room.monoloc", "signature": "room.monoloc/manifest.sig"}
    content = json_of(capfd, "signature", "keys", "new")
    assert content == {"private_key": "new.key", "public_key": "new.pub"}
    content = json_of(capfd, "inspect", "room.monoloc")
    assert content["is_signed"]
    assert content["bytes"] == sum(file.stat().st_size for file in Path("room.monoloc").iterdir())
    run = ("localize", "room.monoloc", "flight", "--start", "truth", "--require-signature", "team.pub")
    assert json_of(capfd, *run)["frames"] == 4


@pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl is not installed")
def test_openssl_agrees(here: Path) -> None:
    bundle, given = Path("room.monoloc"), ["-rawin", "-in", "room.monoloc/manifest.json"]
    check = ["openssl", "pkeyutl", "-verify", "-pubin", *given, "-sigfile", str(bundle / SIGNATURE), "-inkey"]
    assert subprocess.run([*check, "team.pub"], capture_output=True, check=False).returncode == 0
    assert subprocess.run([*check, "other.pub"], capture_output=True, check=False).returncode == 1
    subprocess.run(["openssl", "genpkey", "-algorithm", "ed25519", "-out", "its.key"], check=True)
    subprocess.run(["openssl", "pkey", "-in", "its.key", "-pubout", "-out", "its.pub"], check=True)
    resigned_by(here, "its.key")
    read_bundle(bundle, "its.pub")


def test_the_private_key_is_for_its_owner_and_keys_are_never_replaced(capfd: Capture, here: Path) -> None:
    assert stat.S_IMODE(Path("team.key").stat().st_mode) == 0o600
    before = Path("team.key").read_bytes()
    refused(capfd, here, ("signature", "keys", "team"), "team.key", "exists already", "another name")
    Path("team.key").unlink()
    refused(capfd, here, ("signature", "keys", "team"), "team.pub", "exists already", "another name")
    names = [path for path in Path().rglob("*") if path.is_file() and path.read_bytes() == before]
    assert names == []
    refused(capfd, here, ("signature", "keys", "room.monoloc/new"), "NAME", "lies in the bundle", "another place")
    Path("room.monoloc/team.key").write_bytes(before)
    key = "room.monoloc/team.key"
    refused(capfd, here, ("signature", "sign", "room.monoloc", "--key", key), "--key", "lies in the bundle")


def test_no_half_of_a_pair_is_left_where_the_other_cannot_be_written(tmp_path: Path) -> None:
    inside, outside = tmp_path / "a", tmp_path / "no" / "a"
    for private, public, missing in ((inside, outside, outside), (outside, inside, outside)):
        refuses_data(partial(make_keys, private, public), missing, "cannot be written", "name a file in a folder")
        assert list(tmp_path.iterdir()) == []


def changed_room() -> None:
    """Write another bundle at the name of the signed one, as a build or an edit does."""
    bundle = read_bundle("room.monoloc")
    write_bundle("room.monoloc", replace(bundle, settings=bundle.settings.model_copy(update={"particles": 77})))


def test_a_bundle_that_is_written_again_has_no_signature(capfd: Capture, here: Path) -> None:
    changed_room()
    assert not (here / "room.monoloc" / SIGNATURE).exists()
    assert not json_of(capfd, "inspect", "room.monoloc")["is_signed"]


@pytest.mark.parametrize("case", ["unsigned", "changed", "signed by another", "cut", "too long", "a folder"])
def test_a_required_signature_refuses_all_else_in_one_line(capfd: Capture, here: Path, case: str) -> None:
    signature = here / "room.monoloc" / SIGNATURE
    content = signature.read_bytes()
    changed_room()
    problem, fix = "room.monoloc: was changed, or signed with another key than that of .*team.pub", "copy it again"
    match case:
        case "unsigned":
            problem, fix = "room.monoloc: is not signed", "ask who made it"
        case "changed":
            signature.write_bytes(content)
        case "signed by another":
            resigned_by(here, "other.key")
        case "a folder":
            signature.mkdir()
        case _:
            resigned_by(here, "team.key")
            content = signature.read_bytes()
            signature.write_bytes(content[:-1] if case == "cut" else content + b"\n")
    Path("flight.toml").write_text('room = "room.monoloc"\nrequire_signature = "team.pub"\nsource = "flight"\n')
    key = ("--require-signature", "team.pub")
    for command in (
        ("fly", "flight.toml", "--fast"),
        ("fly", "room.monoloc", "flight", "--fast", *key),
        ("localize", "room.monoloc", "flight", *key),
        ("doctor", "flight.toml"),
        ("signature", "verify", "room.monoloc", "--key", "team.pub"),
    ):
        refused(capfd, here, command, "", problem, fix)
    read_bundle("room.monoloc")  # as ever, where no signature is asked for


def test_the_key_is_not_overwritten_by_what_is_written(capfd: Capture, here: Path) -> None:
    Path("team.pub").rename("team.csv")  # other names are refused as no table
    key = ("--require-signature", "team.csv", "--out", "team.csv")
    for command in (("fly", "room.monoloc", "flight"), ("localize", "room.monoloc", "flight")):
        refused(capfd, here, (*command, *key), "--out", "team.csv is read by this command", "another place")


def test_what_is_no_key_is_refused(here: Path) -> None:
    Path("encrypted.key").write_bytes(ENCRYPTED)
    Path("rsa.pub").write_bytes(RSA)
    manifest = manifest_content(Path("room.monoloc"))
    for name in ("team.pub", "encrypted.key", "flight/dataset.toml"):
        refuses_data(partial(signature_of, manifest, Path(name)), Path(name), "no Ed25519 private key", "make a pair")
    for name in ("team.key", "rsa.pub", "flight/dataset.toml"):
        refuses_data(partial(read_bundle, "room.monoloc", name), Path(name), "no Ed25519 public key", "give NAME.pub")
    refuses_data(lambda: read_bundle("room.monoloc", "no.pub"), Path("no.pub"), "cannot be read", "name the file")


def test_a_signature_is_written_into_the_bundle_only(capfd: Capture, here: Path) -> None:
    """A bundle that comes from elsewhere may hold a link where the signature goes."""
    signature, elsewhere = here / "room.monoloc" / SIGNATURE, here / "elsewhere"
    signature.unlink()
    elsewhere.write_text("mine")
    signature.symlink_to(elsewhere)
    resigned_by(here, "team.key")
    assert elsewhere.read_text() == "mine" and not signature.is_symlink()
    (here / "room.monoloc/map.npz").write_bytes(b"")
    sign = ("signature", "sign", "room.monoloc", "--key", "team.key")
    refused(capfd, here, sign, "room.monoloc/map.npz", "is not what was written", "copy the bundle")


def test_without_the_extra_a_signed_bundle_opens_and_a_required_signature_names_it(
    here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "cryptography", None)
    read_bundle("room.monoloc")
    refuses(lambda: read_bundle("room.monoloc", "team.pub"), MissingExtraError, 'the extra "sign".*pip install')


def test_a_key_in_a_flight_file_is_beside_it(tmp_path: Path) -> None:
    (tmp_path / "flight.toml").write_text('require_signature = "team.pub"\n')
    assert read_flight_file(tmp_path / "flight.toml").require_signature == tmp_path / "team.pub"
