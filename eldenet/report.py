def closing_table(log, record):
    print(record["metrics"], record["constant_predictor"], record["cost"])
