//go:build tools

// Package prometheus names what the slower proofs watch the platform with, so that one go.mod pins it.
package prometheus

import (
	_ "github.com/prometheus/prometheus/cmd/prometheus"
	_ "github.com/prometheus/prometheus/cmd/promtool"
)
