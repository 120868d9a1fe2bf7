"""Requests of tests by HTTP, as httpx makes them. No server of theirs has a certificate that an authority signed, so
the authorities are read once, and not by each request: that costs more than the request."""

from __future__ import annotations

from functools import partial

import httpx

from robotkube.foundation.certificates.adapters.certificate_authorities import certificate_authorities

client = partial(httpx.Client, verify=certificate_authorities())
get = partial(httpx.get, verify=certificate_authorities())
put = partial(httpx.put, verify=certificate_authorities())
post = partial(httpx.post, verify=certificate_authorities())
patch = partial(httpx.patch, verify=certificate_authorities())
delete = partial(httpx.delete, verify=certificate_authorities())
request = partial(httpx.request, verify=certificate_authorities())
