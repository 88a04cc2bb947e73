"""Design by linear matrix inequalities: their solver in a process of its own, and the methods that use it."""
