"""The provider `existing`: Nodes of a cluster that somebody else made become agents', and are given back."""
