//go:build tools

// Package kubeadm names what makes a node of a container.
package kubeadm

import (
	_ "k8s.io/kubernetes/cmd/kubeadm"
)
