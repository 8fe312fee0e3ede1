"""How estimators are judged: tasks, metrics, the runner, its results and the leaderboard."""
