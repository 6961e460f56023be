def report(log, summary, path):
    pass
