"""The control plane: its programs, certificates and kubeconfigs."""
