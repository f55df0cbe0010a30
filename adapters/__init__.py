"""The methods that come with prbench, each behind the same contract as anybody else's."""
