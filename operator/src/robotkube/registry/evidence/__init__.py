"""Evidence: signed statements about a chart, and the policy that they meet."""
