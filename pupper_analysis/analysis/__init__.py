"""All that is found out about one robot, or one of its stances."""
