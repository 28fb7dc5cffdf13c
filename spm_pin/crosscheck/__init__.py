"""Where the witnesses meet: the paper's tables, and two methods on the same question."""
