"""Why an address can't be reached, in words. Asked when a connection fails: Zenoh says no more than that it did."""

from __future__ import annotations

import socket
import ssl
from collections.abc import Iterable
from typing import TYPE_CHECKING

from terrafuse.exchange.links.transport import Address

if TYPE_CHECKING:
    from terrafuse.keys.identity import Identity

PATIENCE_S = 3.0
ALERT_S = 0.5
"""TLS 1.3 tells of a refused certificate after the handshake, if at all."""
EXPIRED, NOT_YET, UNTRUSTED, WRONG_NAME = {10}, {9}, {18, 19, 20, 21}, {62, 64}
"""OpenSSL's numbers of what is wrong with a certificate (X509_V_ERR_*)."""


def diagnosis(address: Address, identity: Identity | None) -> str:
    """Tries to connect as Zenoh does, and says what came of it, with the remedy."""
    try:
        with socket.create_connection((address.host, address.port), PATIENCE_S) as plain:
            return _silent(address) if identity is None else _over_tls(plain, address, identity)
    except socket.gaierror:
        return f"{address}: no host is named '{address.host}'; check the name, or give its IP address"
    except ConnectionRefusedError:
        return f"nothing listens at {address}; start the station there, or check host and port"
    except TimeoutError:
        return f"{address} does not answer; check that host and network are up, and that no firewall is in between"
    except OSError as error:
        return f"{address} can't be reached: {error.strerror or error}; check address and network"


def listen_trouble(addresses: Iterable[Address], error: str) -> str:
    """What Zenoh's complaint means, with the remedy."""
    where = ", ".join(map(str, addresses))
    if "in use" in error:
        return f"can't listen at {where}: the address is in use; stop who has it, or choose another port"
    if "assign requested" in error:
        return f"can't listen at {where}: this machine has no such address; 0.0.0.0 stands for all that it has"
    if "lookup address" in error:
        return f"can't listen at {where}: no host has this name; 0.0.0.0 stands for all addresses of this machine"
    if "denied" in error.lower():
        return f"can't listen at {where}: permission denied; choose a port over 1023"
    return f"can't listen at {where}: {error.split(' at /')[0]}"


def _silent(address: Address) -> str:
    return (
        f"{address} answers, but not as a station without encryption; if it has keys, use them "
        f"(tls/… and --keys FOLDER), else something else listens there"
    )


def _over_tls(plain: socket.socket, address: Address, identity: Identity) -> str:
    context = ssl.create_default_context(cafile=str(identity.ca_file))
    context.load_cert_chain(identity.certificate_file, identity.key_file)
    try:
        with context.wrap_socket(plain, server_hostname=address.host) as secured:
            secured.settimeout(ALERT_S)
            secured.recv(1)
    except ssl.SSLCertVerificationError as error:
        return _theirs(address, identity, error)
    except TimeoutError:
        return f"{address} takes our certificate, but is no station, or too busy; try again, or check the port"
    except (ssl.SSLError, ConnectionError, OSError) as error:
        return _ours(address, identity, str(getattr(error, "reason", None) or error))
    return f"{address} closed the connection; look at what the station says"


def _theirs(address: Address, identity: Identity, error: ssl.SSLCertVerificationError) -> str:
    code = error.verify_code
    if code in WRONG_NAME:
        return (
            f"the certificate of {address} is for other names than '{address.host}'; connect by one that it is for, "
            f"or make it a new one: terrafuse keys renew STATION --host {address.host}"
        )
    if code in EXPIRED:
        return f"the certificate of {address} has expired; renew it: terrafuse keys renew STATION"
    if code in NOT_YET:
        return f"the certificate of {address} is of a time to come; set the clock of this machine"
    if code in UNTRUSTED:
        return (
            f"the certificate of {address} is not of this fleet ({identity.ca_file}); connect to a station of the "
            "same `terrafuse keys new-fleet`, or take keys of its fleet"
        )
    return f"the certificate of {address} is refused: {error.verify_message}; renew it: terrafuse keys renew STATION"


def _ours(address: Address, identity: Identity, reason: str) -> str:
    reason = reason.lower()
    if "unknown_ca" in reason or "unknown ca" in reason or "decrypt_error" in reason:
        return (
            f"{address} does not know the fleet of {identity.certificate_file}; take keys of its fleet: "
            "terrafuse keys add NAME, there"
        )
    if "expired" in reason:
        return f"{address} says that {identity.certificate_file} has expired; renew it: terrafuse keys renew NAME"
    if "wrong_version" in reason or "unexpected" in reason or "eof" in reason or "reset" in reason:
        return f"{address} does not speak TLS; if it is a station with --insecure, connect so, or give it keys"
    return f"{address} refuses {identity.certificate_file} ({reason}); renew it: terrafuse keys renew NAME"
