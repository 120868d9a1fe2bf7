package main

const architecture = 0xC00000B7 // AUDIT_ARCH_AARCH64

// olderCalls are those of `refused` that newer architectures do not have.
var olderCalls []uint32
