//go:build tools

// Package kind names what makes clusters of containers.
package kind

import (
	_ "sigs.k8s.io/kind"
)
