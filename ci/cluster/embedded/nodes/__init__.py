"""Nodes: containerd, kubelet and kube-proxy in namespaces of their own, and the images that they start from."""
