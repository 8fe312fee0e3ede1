"""Robot files for people: what a file says, what is wrong with it, and questions whose answers make one."""
