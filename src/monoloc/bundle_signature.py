"""Signatures show who made a bundle or a place: Ed25519 over its manifest, which holds the checksums of all else.

A signature is its plain 64 bytes and keys are PEM files, so that OpenSSL makes and checks the same. Needs the extra
``sign``.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from monoloc.errors import BundleError, DataError
from monoloc.extras import require_extra
from monoloc.files import read_regular, write_whole

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

SIGNATURE = "manifest.sig"
"""Name of the signature in a bundle or a place."""

_SIGNATURE_BYTES = 64
_MOST_KEY_BYTES = 1 << 14
_PAGE = "how-to/sign-a-bundle"
_MAKE_ONE = "make a pair by: monoloc signature keys NAME"


def make_keys(private: Path, public: Path) -> None:
    """Make a pair of keys, as two new files; only their owner may read the private one.

    Raises:
        DataError: a file exists already, or cannot be written; neither is left then.
        MissingExtraError: the extra ``sign`` is not installed.
    """
    require_extra("sign")
    from cryptography.hazmat.primitives import serialization as forms
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

    for path in (private, public):
        if os.path.lexists(path):
            raise DataError(path, "exists already", "choose another name: keys are not replaced")
    key = Ed25519PrivateKey.generate()
    secret = key.private_bytes(forms.Encoding.PEM, forms.PrivateFormat.PKCS8, forms.NoEncryption())
    shown = key.public_key().public_bytes(forms.Encoding.PEM, forms.PublicFormat.SubjectPublicKeyInfo)
    write_whole(public, shown)
    try:
        _write_secret(private, secret)
    except OSError as error:
        public.unlink()
        fix = "make room for it, or name a file in a folder you can write to"
        raise DataError(private, f"cannot be written ({error.strerror})", fix) from error


def signature_of(manifest: bytes, private_key: Path) -> bytes:
    """Sign a manifest; returns 64 bytes.

    Raises:
        DataError: the file holds no private key.
        MissingExtraError: the extra ``sign`` is not installed.
    """
    require_extra("sign")
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
    from cryptography.hazmat.primitives.serialization import load_pem_private_key

    key = _key(private_key, lambda content: load_pem_private_key(content, password=None))
    if not isinstance(key, Ed25519PrivateKey):
        raise DataError(private_key, "holds no Ed25519 private key without a passphrase", _MAKE_ONE)
    return key.sign(manifest)


@dataclass(frozen=True)
class PublicKey:
    """The key of who must have signed; kept by a flight, so that its file may go.

    Attributes:
        path: of the file that it was read from.
    """

    path: Path
    _key: Ed25519PublicKey

    def check(self, bundle: Path, manifest: bytes) -> None:
        """Refuse a bundle, or a place, that the owner of the key has not signed as it is.

        Args:
            bundle: its folder, or that of a place.
            manifest: of it, as it is used.

        Raises:
            BundleError: it is not signed, was changed since, or was signed with another key.
        """
        from cryptography.exceptions import InvalidSignature

        try:
            signature = read_regular(bundle / SIGNATURE, _SIGNATURE_BYTES)
            self._key.verify(signature, manifest)
        except FileNotFoundError as error:
            raise BundleError(bundle, "is not signed", "ask who made it for a signed copy", _PAGE) from error
        except (InvalidSignature, OSError, ValueError) as error:
            problem = f"was changed, or signed with another key than that of {self.path}"
            raise BundleError(bundle, problem, "copy it again from who signed it", _PAGE) from error


def read_public_key(path: str | Path) -> PublicKey:
    """Read the public key of who must have signed.

    Raises:
        DataError: the file holds no public key.
        MissingExtraError: the extra ``sign`` is not installed.
    """
    require_extra("sign")
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
    from cryptography.hazmat.primitives.serialization import load_pem_public_key

    path = Path(path)
    key = _key(path, load_pem_public_key)
    if not isinstance(key, Ed25519PublicKey):
        raise DataError(path, "holds no Ed25519 public key", f"give NAME.pub, or {_MAKE_ONE}")
    return PublicKey(path, key)


def _key(path: Path, load: Callable[[bytes], object]) -> object:
    """The key in a file, of whatever kind; None where there is none."""
    try:
        return load(read_regular(path, _MOST_KEY_BYTES))
    except OSError as error:
        raise DataError(path, f"cannot be read ({error.strerror})", "name the file of the key") from error
    except Exception:  # the library has many, for damaged, encrypted and unknown keys
        return None


def _write_secret(path: Path, content: bytes) -> None:
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
    except BaseException:
        with contextlib.suppress(OSError):
            path.unlink()
        raise
