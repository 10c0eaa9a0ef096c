% The seed's program in GNU Octave, pose by pose: section 3 of the method, flat priors.
%
% in:  MAT file with the chain (turns, axes, parameter, joint, signs, generators by factor; tip),
%      joints (J, N), points (m, N), sds (J + m, 1), nominal (n, 1).
% out: MAT file with parameters, chi_squared, iterations, and the time [s] of all but load and save.
function seed_program (in, out)
  problem = load (in);
  started = tic ();
  [parameters, chi_squared, iterations] = calibrate (problem);
  seconds = toc (started);
  save ("-v6", out, "parameters", "chi_squared", "iterations", "seconds");
endfunction

function [p, chi_squared, iterations] = calibrate (a)
  [J, N] = size (a.joints);
  m = rows (a.points);
  p = a.nominal;
  y = zeros (J + m, N);
  for iterations = 1:100
    D = zeros (m * N, numel (p));
    E = zeros (m * N, 1);
    Q = zeros (J + m, m, N);
    for i = 1:N
      own = m * (i - 1) + (1:m);
      corrected = a.sds .* y(:,i);
      [point, by_joint, by_parameter] = linearised (a, a.joints(:,i) + corrected(1:J), p);
      f = point(1:m) - a.points(:,i) - corrected(J+1:end);
      J_y = [by_joint(1:m,:), -eye(m)] .* a.sds';
      [Q_i, R] = qr (J_y', 0);
      D(own,:) = R' \ by_parameter(1:m,:);
      E(own) = Q_i' * y(:,i) - R' \ f;
      Q(:,:,i) = Q_i;
    endfor
    step = D \ E;
    for i = 1:N
      own = m * (i - 1) + (1:m);
      y(:,i) = Q(:,:,i) * (E(own) - D(own,:) * step);
    endfor
    p += step;
    chi_squared = sum (y(:) .^ 2);
    sd = sqrt (diag (inv (D' * D)));
    if (max (abs (step) ./ sd) <= 1e-6)
      return;
    endif
  endfor
  error ("the seed's program did not converge");
endfunction

% Point of one pose and its derivatives: the product of 4x4 matrices, one of them differentiated.
function [point, by_joint, by_parameter] = linearised (a, theta, p)
  count = numel (a.turns);
  T = cell (1, count);
  left = cell (1, count + 1);
  left{1} = eye (4);
  for i = 1:count
    if (a.parameter(i))
      amount = p(a.parameter(i));
    else
      amount = a.signs(i) * theta(a.joint(i));
    endif
    T{i} = elementary (a.turns(i), a.axes(i), amount);
    left{i+1} = left{i} * T{i};
  endfor
  by_joint = zeros (3, numel (theta));
  by_parameter = zeros (3, numel (p));
  right = [0; 0; 0; 1];
  tips = numel (a.tip);
  right(1:tips) = p(a.tip);
  by_parameter(:,a.tip) = left{end}(1:3,1:tips);
  for i = count:-1:1
    column = left{i+1} * (a.generators(:,:,i) * right);
    if (a.parameter(i))
      by_parameter(:,a.parameter(i)) = column(1:3);
    else
      by_joint(:,a.joint(i)) = a.signs(i) * column(1:3);
    endif
    right = T{i} * right;
  endfor
  point = right(1:3);
endfunction

function T = elementary (turns, axis, amount)
  T = eye (4);
  if (! turns)
    T(axis,4) = amount;
    return;
  endif
  c = cos (amount);
  s = sin (amount);
  switch (axis)
    case 1
      T(2:3,2:3) = [c, -s; s, c];
    case 2
      T([1, 3],[1, 3]) = [c, s; -s, c];
    case 3
      T(1:2,1:2) = [c, -s; s, c];
  endswitch
endfunction
