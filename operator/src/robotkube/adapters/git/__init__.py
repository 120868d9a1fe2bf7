"""Git by libgit2: bare clones of the forge's repositories, commits made in them and proposed, and notes."""

from robotkube.adapters.git.clones import GitClone
from robotkube.adapters.git.notes import GitNotes
from robotkube.adapters.git.proposals import ProposalWriter

__all__ = ["GitClone", "GitNotes", "ProposalWriter"]
