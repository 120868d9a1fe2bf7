"""What runs, compared with what may run: strangers are named, and removed where the policy says so."""
