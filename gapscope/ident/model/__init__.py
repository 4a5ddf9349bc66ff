"""The linear model of identification: regressor, base parameters, friction laws."""
