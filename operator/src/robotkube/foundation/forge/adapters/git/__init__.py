"""Git by libgit2: bare clones of the forge's repositories, commits made in them and proposed, and notes."""

from robotkube.foundation.forge.adapters.git.clones import GitClone
from robotkube.foundation.forge.adapters.git.histories import GitHistory, fetch_history
from robotkube.foundation.forge.adapters.git.notes import GitNotes
from robotkube.foundation.forge.adapters.git.proposals import ProposalWriter
from robotkube.foundation.forge.adapters.git.working_clones import WorkingClone

__all__ = ["GitClone", "GitHistory", "GitNotes", "ProposalWriter", "WorkingClone", "fetch_history"]
