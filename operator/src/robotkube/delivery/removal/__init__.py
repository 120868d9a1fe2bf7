"""The remover: what inspections name as strangers is taken away, in agents' namespaces and where the policy says so"""
