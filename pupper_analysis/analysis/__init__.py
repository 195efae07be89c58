"""All that is found out about one robot, or about one of its stances: a module per question."""
