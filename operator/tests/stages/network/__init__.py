"""Network policies as rules: what their text means, random policies, nodes made of real network namespaces."""
