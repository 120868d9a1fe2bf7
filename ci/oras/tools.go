//go:build tools

// Package oras names what copies bundles: of oras, crane, regctl and skopeo the one that takes what is attached along
// and reads a layout out of its archive.
package oras

import (
	_ "oras.land/oras/cmd/oras"
)
