//go:build tools

// Package provisioner names what makes volumes of folders of nodes.
package provisioner

import (
	_ "github.com/rancher/local-path-provisioner"
)
