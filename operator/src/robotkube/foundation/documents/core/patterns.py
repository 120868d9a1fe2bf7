"""Patterns of identifiers: the one place that says what a name, version, digest, topic or address looks like.

Matched as a whole (`fullmatch`); JSON schemas take them through `anchored`. Sources: names are labels of DNS (RFC 1123)
as Kubernetes asks for, versions those of semver.org without build metadata, digests those of the OCI image
specification, ROS names those of design.ros2.org/articles/topic_and_service_names.html and of rosidl.
"""

from __future__ import annotations

import re

DOCUMENTS_CACHED_MAX = 4096  # documents that were read stay in memory: a plan needs all of them

_LABEL = r"[a-z0-9]([a-z0-9-]{0,61}[a-z0-9])?"
_SUBDOMAIN = r"[a-z0-9]([a-z0-9.-]{0,251}[a-z0-9])?"
_FILE_NAME_100 = r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}"
_KEY = r"[A-Za-z_][A-Za-z0-9_.-]*"
_HEX_32 = r"[0-9a-f]{32}"
_SHA256 = r"sha256:[0-9a-f]{64}"
_NUMBER = r"(?:0|[1-9][0-9]{0,8})"
_IDENTIFIER = r"(?:0|[1-9][0-9]*|[0-9]*[A-Za-z-][0-9A-Za-z-]*)"
_PRE_RELEASE = rf"(-(?![0-9A-Za-z.-]{{65}}){_IDENTIFIER}(\.{_IDENTIFIER})*)?"

# Names that become names of objects in Kubernetes.
NAME = re.compile(_LABEL, re.ASCII)  # of an agent, area, application, release, requirement, image in a chart
NAME_OR_ALL = re.compile(rf"[*]|{_LABEL}", re.ASCII)
ALL = "*"  # the one word of NAME_OR_ALL that is no name
SUBDOMAIN = re.compile(_SUBDOMAIN, re.ASCII)  # of a custom resource, rule or recording: with dots, unlike NAME
TASK = re.compile(rf"{_LABEL}/{_SUBDOMAIN}", re.ASCII)  # <namespace>/<name>
POD_NAME = re.compile(rf"(?P<deployment>{_LABEL})-[a-z0-9]{{1,10}}-[a-z0-9]{{5}}", re.ASCII)  # of a Deployment's pod
SECRET_KEY = re.compile(_FILE_NAME_100, re.ASCII)

# Charts and what they declare.
CHART_NAME = re.compile(r"[a-z0-9]+(-[a-z0-9]+)*", re.ASCII)
NEW_CHART_NAME = re.compile(r"[a-z]([a-z0-9]|-(?=[a-z0-9])){0,28}[a-z0-9]", re.ASCII)  # short: releases add to it
NEW_SERVICE_NAME = re.compile(r"[a-z]([a-z0-9]|-(?=[a-z0-9]))*", re.ASCII)  # behind the name of its application
VERSION = re.compile(rf"{_NUMBER}\.{_NUMBER}\.{_NUMBER}{_PRE_RELEASE}", re.ASCII)
CHART_VERSION = re.compile(rf"{VERSION.pattern}(\+[0-9A-Za-z.-]{{1,64}})?", re.ASCII)  # of a chart's own file
BUNDLE_VERSION = re.compile(r"[0-9][0-9A-Za-z._+-]{0,99}", re.ASCII)  # the platform's, part of names of archives
BUNDLED_VERSION = re.compile(r"[0-9A-Za-z][0-9A-Za-z._+-]{0,99}", re.ASCII)  # of a thing in a bundle, such as v3.1.0
CAPABILITY = re.compile(r"[a-z0-9-]+(/[a-z0-9-]+)*", re.ASCII)
VALUES_PATH = re.compile(r"[A-Za-z0-9_-]{1,63}(\.[A-Za-z0-9_-]{1,63}){0,15}", re.ASCII)
VARIABLE = re.compile(r"[a-z][a-z0-9_]*", re.ASCII)  # of forEach in a value template
PARAMETER_KEY = re.compile(_KEY, re.ASCII)
COLLECTION = re.compile(_KEY, re.ASCII)  # of the document database
ARCHIVE_PART = re.compile(r"[A-Za-z0-9_.@+-]{1,100}", re.ASCII)  # of a path in a packed chart

# Digests, images and their platforms.
DIGEST = re.compile(_SHA256, re.ASCII)
DIGEST_IN_TEXT = re.compile(r"\bsha256:([0-9a-f]{12})[0-9a-f]{52}\b", re.ASCII)
DIGEST_START = re.compile(r"(sha256:)?(?P<digits>[0-9a-f]{7,64})", re.ASCII)  # as tables shorten it
EVIDENCE = re.compile(rf"none|{_SHA256}", re.ASCII)
IMAGE_BY_DIGEST = re.compile(rf"[A-Za-z0-9][A-Za-z0-9./:_-]{{0,254}}@{_SHA256}", re.ASCII)
IMAGE = re.compile(r"[A-Za-z0-9][A-Za-z0-9._/:@-]{0,400}", re.ASCII)  # in settings: by tag or by digest
IMAGE_PARTS = re.compile(  # host, repository and digest, as requests to an OCI registry need them; no tag
    rf"([a-z0-9.-]+(?::\d{{1,5}})?)/([a-z0-9]+(?:[._/-]+[a-z0-9]+)*)@({_SHA256})", re.ASCII
)
PLATFORM = re.compile(r"[a-z0-9]+/[a-z0-9]+(/[a-z0-9]+)?", re.ASCII)  # such as linux/arm64

# Suites, plans, runs and traces.
SUITE_NAME = re.compile(r"[a-z]([a-z0-9-]{0,38}[a-z0-9])?", re.ASCII)
SUITE_VERSION = re.compile(r"[0-9A-Za-z][0-9A-Za-z._-]{0,31}", re.ASCII)
SUITE_RUN = re.compile(_HEX_32, re.ASCII)
TEST_NAMESPACE = re.compile(r"robotkube-suite-[0-9]+", re.ASCII)  # of the suite-runner's pool, as the chart makes it
ATTEMPT = re.compile(r"[0-9A-Za-z._-]{0,64}", re.ASCII)
PLAN = re.compile(r"\d{8}-\d{6}-[0-9a-f]{6}", re.ASCII)
PLAYER_RUN = re.compile(_FILE_NAME_100, re.ASCII)
TRACE = re.compile(_HEX_32, re.ASCII)  # trace-id of www.w3.org/TR/trace-context
TOKEN = re.compile(r"[A-Za-z0-9][A-Za-z0-9._:-]{0,127}", re.ASCII)

# Forges: WORD is an account, a branch, a host or a namespace in a settings file.
WORD = re.compile(r"[A-Za-z0-9]([A-Za-z0-9._-]*[A-Za-z0-9])?", re.ASCII)
REPOSITORY = re.compile(r"[a-z0-9][a-z0-9._-]*/[a-z0-9][a-z0-9._-]*", re.ASCII)  # <owner>/<name>
COMMIT = re.compile(r"[0-9a-f]{40}", re.ASCII)
COMMIT_START = re.compile(r"[0-9a-f]{7,40}", re.ASCII)  # as people shorten it
FOLDER = re.compile(r"(/[A-Za-z0-9._@+-]+)+", re.ASCII)  # of a machine
PATH_PREFIX = re.compile(r"[A-Za-z0-9._-]+(/[A-Za-z0-9._-]+)*/?", re.ASCII)  # a file, or a folder with its slash

# Addresses. A webhook's may have a query and an IPv6 host; its port and host are judged apart.
HTTP_URL = re.compile(r"https?://[A-Za-z0-9.-]+(:\d{1,5})?(/[A-Za-z0-9._/-]*[A-Za-z0-9._-])?", re.ASCII)
CHARTS_URL = re.compile(r"oci://[A-Za-z0-9.-]+(:\d{1,5})?(/[a-z0-9][a-z0-9._-]*)+", re.ASCII)
WEBHOOK_URL = re.compile(
    r"https?://(?P<host>[A-Za-z0-9][-.A-Za-z0-9]*|\[[0-9a-fA-F:]+\])(:(?P<port>[1-9][0-9]{0,4}))?(/[!-~]*)?"
)
DNS_NAME = re.compile(r"[a-z0-9*]([-a-z0-9.]{0,251}[a-z0-9])?", re.ASCII)  # of a certificate: * stands for a label
HOST = re.compile(r"[A-Za-z0-9]([A-Za-z0-9.-]{0,252})", re.ASCII)  # as browsers name it
ADDRESSES = re.compile(r"[0-9a-fA-F.:]+(/\d{1,3})?", re.ASCII)  # one, or a range of them
REGISTRY_PATH = re.compile(  # host and path, where repositories stand below the path
    r"(?P<host>[A-Za-z0-9.-]+(?::\d{1,5})?)/(?P<path>[a-z0-9]+(?:[._/-]+[a-z0-9]+)*)", re.ASCII
)
HOST_LABEL = re.compile(r"[A-Za-z0-9]([-A-Za-z0-9]{0,61}[A-Za-z0-9])?", re.ASCII)

# ROS and MQTT.
ROS_AGENT = re.compile(r"[a-z][a-z0-9_]{0,62}", re.ASCII)  # an agent's NAME as a part of a ROS name
ROS_TOPIC = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+", re.ASCII)
ROS_TOPIC_CHARACTERS_MAX = 247  # RMW_TOPIC_MAX_NAME_LENGTH in rmw/validate_full_topic_name.h: 255, and 8 for prefixes
MQTT_TOPIC_CHARACTERS_MAX = 255
ROS_TOPIC_PATTERN = re.compile(  # a topic, or one per agent: {agent} stands for any agent's ROS name
    r"(/([A-Za-z_][A-Za-z0-9_]*|([A-Za-z_][A-Za-z0-9_]*)?\{agent\}[A-Za-z0-9_]*))+", re.ASCII
)
ROS_TYPE = re.compile(r"[a-z][a-z0-9_]*/msg/[A-Z][A-Za-z0-9]*", re.ASCII)
ROS_PACKAGE = re.compile(r"[a-z](?:_?[a-z0-9])*", re.ASCII)  # of a new package: rosidl takes no two `_` in a row
MESSAGE_FILE = re.compile(r"[A-Z][A-Za-z0-9]*\.msg", re.ASCII)
ROS_WORD = re.compile(r"[A-Za-z][A-Za-z0-9_]*", re.ASCII)  # of a package, message or field in a definition
EXPRESSION_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*", re.ASCII)
AGENTS_MQTT_TOPIC = re.compile(r"[A-Za-z0-9_/{}-]{1,200}", re.ASCII)  # {agent} stands for any agent's ROS name
MQTT_TOPIC = re.compile(rf"[^\s+#$/][^\s+#]{{0,{MQTT_TOPIC_CHARACTERS_MAX - 1}}}")  # of one topic, without wildcards


def anchored(pattern: re.Pattern[str]) -> str:
    """The pattern as a JSON schema writes it, where a match anywhere in a text counts."""
    return f"^{pattern.pattern}$"


def anchored_or_empty(pattern: re.Pattern[str]) -> str:
    """The pattern as a JSON schema writes it, for a text that may be empty."""
    return f"^({pattern.pattern})?$"
