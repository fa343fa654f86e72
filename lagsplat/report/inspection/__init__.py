"""What a file holds, in words, before anything is trained on it: a recording or video, a log, a dataset."""
