"""The thesis's experiments of chapters 5 and 6 on logs of one's own: what they tell, and how surely."""
