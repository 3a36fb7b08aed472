"""Selection of features over a survey: the training sample in spatial folds, trials as parts, results as files."""
