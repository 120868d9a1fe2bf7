"""NetworkPolicies as rules of nftables in each node's network namespace."""
