"""containerd's settings, the same for a node and for the one that imports images."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

# None of these is used here; each would cost a folder outside of the cluster's, a socket or idle work.
DISABLED = (
    "io.containerd.image-verifier.v1.bindir",
    "io.containerd.internal.v1.tracing",
    "io.containerd.monitor.container.v1.restart",
    "io.containerd.nri.v1.nri",
    "io.containerd.snapshotter.v1.blockfile",
    "io.containerd.snapshotter.v1.erofs",
    "io.containerd.snapshotter.v1.native",
    "io.containerd.tracing.processor.v1.otlp",
)
CNI_PROGRAMS = "/usr/lib/cni"
STATISTICS_PERIOD_SECONDS = 300


@dataclass(frozen=True)
class ContainerdSettings:
    """Places of one containerd; `sandbox` is the pause image's reference, `hosts` the folder that says from where it
    pulls (pulling.py)."""

    root: Path
    state: Path
    sandbox: str
    runc: Path
    cni: Path
    hosts: Path

    def toml(self) -> str:
        """The configuration file."""
        disabled = ", ".join(f'"{name}"' for name in DISABLED)
        return f"""version = 3
root = "{self.root}"
state = "{self.state}"
disabled_plugins = [{disabled}]

[grpc]
address = "{self.state}/containerd.sock"
[ttrpc]
address = "{self.state}/containerd.sock.ttrpc"

[plugins."io.containerd.internal.v1.opt"]
path = "{self.root}/opt"
[plugins."io.containerd.metadata.v1.bolt"]
no_sync = true  # the cluster is made anew after a crash
[plugins."io.containerd.monitor.task.v1.cgroups"]
no_prometheus = true

[plugins."io.containerd.cri.v1.images"]
snapshotter = "overlayfs"
stats_collect_period = {STATISTICS_PERIOD_SECONDS}
[plugins."io.containerd.cri.v1.images".pinned_images]
sandbox = "{self.sandbox}"
[plugins."io.containerd.cri.v1.images".registry]
config_path = "{self.hosts}"

[plugins."io.containerd.cri.v1.runtime"]
restrict_oom_score_adj = true  # some machines withhold the capability to lower it
netns_mounts_under_state_dir = true
stats_collect_period = "{STATISTICS_PERIOD_SECONDS}s"  # the default of one second wakes every shim each time
stats_retention_period = "{3 * STATISTICS_PERIOD_SECONDS}s"
[plugins."io.containerd.cri.v1.runtime".cni]
bin_dirs = ["{CNI_PROGRAMS}"]
conf_dir = "{self.cni}"
use_internal_loopback = true
[plugins."io.containerd.cri.v1.runtime".containerd.runtimes.runc]
runtime_type = "io.containerd.runc.v2"
[plugins."io.containerd.cri.v1.runtime".containerd.runtimes.runc.options]
SystemdCgroup = false
BinaryName = "{self.runc}"
"""
