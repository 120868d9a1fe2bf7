"""Policy for PersistentVolumes: a volume is another way to a machine's files."""

from __future__ import annotations

from robotkube.registry.admission.core.documents import Policy, Validation
from robotkube.registry.admission.core.expressions import sentence
from robotkube.registry.admission.core.lists import texts

# What a volume's specification may have besides its place, of which `local` is the only one: every other kind of source
# has a key of its own here, and `mountOptions` are the machine's `mount` to read.
PARTS = (
    "accessModes",
    "capacity",
    "claimRef",
    "nodeAffinity",
    "persistentVolumeReclaimPolicy",
    "storageClassName",
    "volumeMode",
)
OPTIONS = "volume.beta.kubernetes.io/mount-options"  # which kubelets still read
NUMBERED = "[a-z0-9]([a-z0-9.-]*[a-z0-9])?/(0|[1-9][0-9]*)"
NAME = "object.metadata.name"


def policy(folder: str) -> Policy:
    """A volume is exactly one of the folders `<folder>/<node>/<number>`. A pod writes into these and nowhere above, so
    it can put no symbolic link where a volume may be: kubelets follow one that stands there. Status is judged as well,
    since annotations come that way too."""
    place = "object.spec.?local.?path.orValue('')"
    parts = texts((*PARTS, "local", "mountOptions"))
    of_the_cluster = (
        f"object.spec.all(k, k in {parts}) && {place}.startsWith('{folder}/') && "
        f"{place}.substring('{folder}/'.size()).matches('^{NUMBERED}$') && object.spec.local.all(k, k == 'path')"
    )
    where = f" is of a folder that is not for volumes. Use one of those that the cluster was made with: {folder}/"
    plainly = f"!has(object.spec.mountOptions) && !('{OPTIONS}' in object.metadata.?annotations.orValue({{}}))"
    how = f" has options for mounting, which could lead to other files. Take mountOptions and {OPTIONS} away"
    rules = [
        Validation(of_the_cluster, sentence("PersistentVolume ", NAME, f"{where}<node>/<number>")),
        Validation(plainly, sentence("PersistentVolume ", NAME, how)),
    ]
    kinds = [("", ["persistentvolumes", "persistentvolumes/status"])]
    return Policy("robotkube-volumes", kinds, None, [], rules)
