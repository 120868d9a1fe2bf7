"""A platform's repositories, to audit and to manipulate."""
