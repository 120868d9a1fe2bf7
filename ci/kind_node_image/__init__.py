"""An image of kind's nodes, made of the tool chain, kubeadm and Debian's packages, for machines on which kind's own
cannot be pulled. Only `make kind-node-image` makes it, and the tool chain does not depend on what is in it."""
