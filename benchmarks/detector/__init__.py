"""The event detector and what runs in its process: input, rules, recording; from a bag as well."""
