"""Git and the hosts of repositories: clones, commits proposed by pull request, reviews, push hooks."""
