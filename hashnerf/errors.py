"""The errors a user can cause and mend. Scripts print them without a traceback and exit with status 2."""


class UserError(Exception):
    """Something the user gave is wrong; the message is one sentence naming the file, key or value and what to do."""


class DataError(UserError):
    """A data set has problems; `problems` holds one line each and the message joins them."""

    def __init__(self, source: str, problems: list[str]):
        self.source = source
        self.problems = list(problems)
        count = len(self.problems)
        noun = "problem" if count == 1 else "problems"
        super().__init__(f"{source}: {count} {noun}\n" + "\n".join(f"  {line}" for line in self.problems))
